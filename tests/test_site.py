"""Tests of the documentation site: it builds without a warning, needs no network, and its generated pages are up to
date.
"""

from __future__ import annotations

import importlib.util
import json
import os
import re
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
from latex2mathml.converter import convert

from tests.ident.pages import CHROMIUM, PAGES, browser

ROOT = Path(__file__).resolve().parents[1]
# Elements that a browser fetches by itself when it opens a page.
FETCHES = {"script": "src", "link": "href", "img": "src", "iframe": "src", "source": "src", "video": "src"}
NO_FETCH = {"canonical", "next", "prev", "edit"}


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site. The fixture fails if MkDocs reports a problem."""
    out = tmp_path_factory.mktemp("site")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--quiet", "--site-dir", str(out)]
    environment = os.environ | {"NO_MKDOCS_2_WARNING": "1"}
    done = subprocess.run(words, cwd=ROOT, env=environment, capture_output=True, text=True, timeout=200, check=False)
    assert done.returncode == 0, done.stderr
    assert not done.stderr.strip()
    return out


class Fetched(HTMLParser):
    """Parser that collects the links of a page and the files that a browser fetches for it."""

    def __init__(self, page: Path) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.links: list[str] = []
        self.feed(page.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        if tag in FETCHES and values.get("rel") not in NO_FETCH:
            self.fetched.append(values.get(FETCHES[tag]) or "")
        if tag == "a":
            self.links.append(values.get("href") or "")


def test_no_page_asks_the_network(site: Path) -> None:
    pages = [page for page in site.rglob("*.html") if page.name != "thesis-figures.html"]
    assert len(pages) > 40
    for page in pages:
        outside = [address for address in Fetched(page).fetched if re.match(r"(https?:)?//", address)]
        assert not outside, page.relative_to(site)


def test_every_page_of_the_docs_is_in_the_navigation(site: Path) -> None:
    links = {
        (site / link.partition("#")[0]).resolve() for link in Fetched(site / "index.html").links if "://" not in link
    }
    for page in (ROOT / "docs").rglob("*.md"):
        built = site / page.relative_to(ROOT / "docs").with_suffix(".html")
        if page.name == "README.md":
            built = built.with_name("index.html")
        assert built.is_file(), page.name
        assert built.resolve() in links, f"{page.name} is not in the navigation"


def test_the_page_of_figures_and_the_page_of_tables_both_exist(site: Path) -> None:
    assert (site / "thesis-figures.html").read_bytes() == (ROOT / "docs/thesis.html").read_bytes()
    assert "thesis-figures.html" in Fetched(site / "thesis.html").links


class Browser:
    """Headless Chromium with one page, driven by the DevTools protocol over a pipe. It resolves no name of a host.

    ``requested`` has the addresses that the page and its frames have requested, in order.
    """

    def __init__(self, folder: Path) -> None:
        self.requested: list[str] = []
        to_browser, self._commands = os.pipe()
        self._replies, from_browser = os.pipe()
        options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"]
        options += [f"--user-data-dir={folder / 'profile'}", "--host-resolver-rules=MAP * ~NOTFOUND"]
        ends = f"exec 3<&{to_browser} 4>&{from_browser}; exec "  # Chromium reads from 3 and writes to 4
        self._process = subprocess.Popen(
            ["bash", "-c", ends + '"$@"', "bash", str(CHROMIUM), *options, "--remote-debugging-pipe", "about:blank"],
            pass_fds=(to_browser, from_browser),
            stderr=subprocess.DEVNULL,
        )
        os.close(to_browser)
        os.close(from_browser)
        self._left, self._id, self._session = b"", 0, ""
        targets = self.call("Target.getTargets")["targetInfos"]
        page = next(t["targetId"] for t in targets if t["type"] == "page")
        self._session = self.call("Target.attachToTarget", targetId=page, flatten=True)["sessionId"]
        self.call("Network.enable")

    def call(self, method: str, **params: Any) -> dict[str, Any]:
        """Send a command, and return its result."""
        self._id += 1
        message = {"id": self._id, "method": method, "params": params}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._commands, json.dumps(message).encode() + b"\0")
        while True:
            reply = self._next()
            if reply.get("method") == "Network.requestWillBeSent":
                self.requested.append(reply["params"]["request"]["url"])
            if reply.get("id") == self._id:
                assert "error" not in reply, reply
                return dict(reply["result"])

    def _next(self) -> dict[str, Any]:
        while b"\0" not in self._left:
            part = os.read(self._replies, 1 << 16)
            assert part, "the browser has ended"
            self._left += part
        message, _, self._left = self._left.partition(b"\0")
        return dict(json.loads(message))

    def value(self, expression: str) -> Any:
        """Return the value of an expression in the page. The value of a promise is awaited."""
        found = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, expression: str, seconds: float = 30.0) -> Any:
        """Return the value of an expression in the page, as soon as it is true."""
        end = time.monotonic() + seconds
        while not (value := self.value(expression)):
            assert time.monotonic() < end, expression
            time.sleep(0.05)
        return value

    def close(self) -> None:
        self._session = ""
        self.call("Browser.close")
        os.close(self._commands)
        os.close(self._replies)
        self._process.wait(30)


LINKS = "[...document.querySelectorAll('.md-search-result__link')].map(link => link.href)"


@browser
@pytest.mark.slow
@pytest.mark.parametrize("page", ["index.html", "how-to/python.html"])
def test_the_search_works_from_the_disk_without_a_network(site: Path, tmp_path: Path, page: str) -> None:
    """A word that is typed into the field gives pages that contain it, and no other host is asked."""
    chrome = Browser(tmp_path)
    try:
        chrome.call("Page.navigate", url=(site / page).as_uri())
        chrome.wait("document.readyState == 'complete' && !!document.querySelector('.md-search__input')")
        chrome.value("document.querySelector('.md-search__input').focus()")
        for letter in "antenna":
            chrome.call("Input.dispatchKeyEvent", type="keyDown", text=letter, key=letter)
            chrome.call("Input.dispatchKeyEvent", type="keyUp", key=letter)
        links = chrome.wait(f"(links => links[0]?.includes('h=antenna') && links)({LINKS})")
        assert len(links) > 3
        first = Path(re.sub(r"[?#].*", "", links[0]).removeprefix("file://"))
        assert "antenna" in first.read_text(encoding="utf-8")
        assert first.parent.name != "decisions"
    finally:
        chrome.close()
    assert any("search_index.js" in address for address in chrome.requested)
    outside = [address for address in chrome.requested if not address.startswith(("file:", "data:", "blob:", "about:"))]
    assert not outside


# Pages of tables, of equations and of code; the light scheme in a wide window, and the dark one in a narrow window.
CHECKED = ("index.html", "theory/estimation.html", "how-to/python.html")
VIEWS = (("light", 1400), ("dark", 390))
AXE = ROOT / "tests/axe-core/axe.min.js"
# The theme has added its buttons, and no colour changes any more.
SETTLED = """(async () => {
    for (let k = 0; k < 2; k++) await new Promise(requestAnimationFrame)
    await Promise.all(document.getAnimations().filter(a => a instanceof CSSTransition).map(a => a.finished))
})()"""
VIOLATIONS = """axe.run(document, {resultTypes: ["violations"]}).then(found => found.violations.map(
    rule => [rule.id, ...rule.nodes.map(node => `${node.target}: ${node.failureSummary}`)]))"""


def violations(chrome: Browser, page: Path, scheme: str, width: int) -> list[list[str]]:
    """Open a page as for the first time, and return the rules of axe-core that it breaks, with the elements."""
    chrome.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
    chrome.call("Emulation.setDeviceMetricsOverride", width=width, height=900, deviceScaleFactor=1, mobile=False)
    for address in (page.as_uri(), "about:blank", page.as_uri()):
        chrome.call("Page.navigate", url=address)
        chrome.wait(f"document.readyState == 'complete' && location.href == {json.dumps(address)}")
        if address != "about:blank":
            chrome.value("localStorage.clear()")  # the theme keeps the scheme of the first visit
    if chrome.value("'mdColorScheme' in document.body.dataset"):
        chrome.wait(f"document.body.dataset.mdColorScheme == '{'slate' if scheme == 'dark' else 'default'}'")
        chrome.wait(
            "[...document.querySelectorAll('pre > code')].every(code => code.parentElement.querySelector('nav'))"
        )
    chrome.value(SETTLED)
    chrome.value(AXE.read_text(encoding="utf-8") + "; 0")
    return list(chrome.value(VIOLATIONS))


@browser
@pytest.mark.slow
def test_the_site_and_a_report_have_no_violation_of_axe(site: Path, tmp_path: Path) -> None:
    PAGES["thruster"](tmp_path / "report.html")
    chrome = Browser(tmp_path)
    try:
        for page in (*(site / name for name in CHECKED), tmp_path / "report.html"):
            for scheme, width in VIEWS:
                assert violations(chrome, page, scheme, width) == [], f"{page.name}, {scheme}, {width} px"
    finally:
        chrome.close()


@browser
@pytest.mark.slow
def test_axe_finds_what_the_site_mends(site: Path, tmp_path: Path) -> None:
    """Without the style sheet and the script of the site, a page breaks each of these rules."""
    text = (site / "how-to/python.html").read_text(encoding="utf-8")
    text = re.sub(r'<(link|script)[^>]*site/(site.css|wide.js)">', "", text).replace(
        "../assets", f"{site.as_uri()}/assets"
    )
    (tmp_path / "page.html").write_text(text, encoding="utf-8")
    chrome = Browser(tmp_path)
    try:
        found = {rule for rule, *_ in violations(chrome, tmp_path / "page.html", "dark", 390)}
    finally:
        chrome.close()
    assert {"color-contrast", "landmark-unique", "link-in-text-block", "scrollable-region-focusable"} <= found


def test_dialogs_and_parts_of_the_navigation_have_names(site: Path) -> None:
    for page in site.rglob("*.html"):
        if page.name == "thesis-figures.html":
            continue
        text = page.read_text(encoding="utf-8")
        (dialog,) = re.findall(r'<[^>]*role="dialog"[^>]*>', text)
        assert 'aria-label="Search"' in dialog, page.name
        assert len(re.findall(r'<nav [^>]*(aria-label="[^"]+"|role="none")', text)) == text.count("<nav "), page.name
        parts = re.findall(r'<nav [^>]*data-md-level="\d+"[^>]*>', text)
        names = [name for part in parts for name in re.findall(r'aria-label="([^"]+)"', part)]
        assert len(set(names)) == len(names), page.name
        assert {"Tutorials", "How to", "Decisions"} <= set(names), page.name


def test_the_index_of_the_search_contains_every_page(site: Path) -> None:
    text = (site / "search/search_index.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("var __index = "))
    pages = {entry["location"].partition("#")[0] for entry in index["docs"]}
    built = {str(p.relative_to(site)) for p in site.rglob("*.html")} - {"404.html", "thesis-figures.html"}
    assert built <= pages


def script(name: str) -> ModuleType:
    """Load a script of docs/site as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / f"docs/site/{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # named tuples in the script look up their module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def architecture() -> ModuleType:
    return script("architecture")


def test_the_page_of_results_is_up_to_date() -> None:
    results = script("results")
    text = results.PAGE.read_text(encoding="utf-8")
    assert text == results.page(text), "run `python docs/site/results.py`"


def test_the_page_of_effects_is_up_to_date_and_has_every_effect() -> None:
    effects = script("effects")
    text = effects.PAGE.read_text(encoding="utf-8")
    assert text == effects.page(), "run `python docs/site/effects.py`"
    assert text.count("\n### ") == len(effects.built_in())
    assert len(effects.built_in()) > 70


@pytest.mark.parametrize(
    ("formula", "tex"),
    [
        ("X -= d_uuu u^3", r"X \leftarrow X - d_{uuu} \, u^{3}"),
        ("Y -= (Y_r + k) r + b", r"Y \leftarrow Y - ((Y_{r} + k) \, r + b)"),
        (
            "f_L *= 1 - rho |n| for n < 0",
            r"f_{L} \leftarrow f_{L} \, (1 - \rho \, \left| n \right|) \text{ for } n < 0",
        ),
        ("f /= 2 k", r"f \leftarrow f / (2 \, k)"),
        ("T n_eff' = n|n|^(1/8) - z''", r"T \, \dot{n}_{\mathrm{eff}} = n \left| n \right|^{1 / 8} - \ddot{z}"),
        (
            "V = R(psi)' x, x = sqrt(2 k)",
            r"\begin{aligned} & V = R (\psi)^{\top} \, x \\ & x = \sqrt{2 \, k} \end{aligned}",
        ),
        ("v = r x l, t / 600 s", r"v = r \times l, t / 600 \,\mathrm{s}"),
        ("u @ v", None),
        ("u (v", None),
        ("|u v", None),
        ("u''' = 1", None),
        ("u^", None),
    ],
)
def test_formulas_are_converted_to_tex(formula: str, tex: str | None) -> None:
    assert script("formulas").formula_tex(formula) == tex


def test_browsers_can_show_the_formulas_of_all_effects() -> None:
    effects, formulas = script("effects"), script("formulas")
    for effect in effects.built_in().values():
        tex = formulas.formula_tex(effect.formula)
        assert tex, effect.name
        shown = ElementTree.fromstring(convert(tex.replace("{aligned}", "{align*}")))
        assert "\\" not in "".join(shown.itertext()), effect.name


def test_the_architecture_page_is_up_to_date(architecture: ModuleType) -> None:
    advice = "run `python docs/site/architecture.py`"
    assert architecture.PICTURE.read_text(encoding="utf-8") == architecture.svg(), advice
    text = architecture.PAGE.read_text(encoding="utf-8")
    assert text == architecture.page(text), advice


def test_arrows_of_the_architecture_are_the_permitted_imports(architecture: ModuleType) -> None:
    rules = [
        {"source_modules": ["daq", "mocks"], "forbidden_modules": ["bench", "ident", "seatrial"]},
        {"source_modules": ["daq"], "forbidden_modules": ["mocks"]},
        {
            "source_modules": ["ident"],
            "forbidden_modules": ["daq"],
            "ignore_imports": [
                "ident -> daq.face",
                "ident.** -> daq.face",
                "ident.** -> daq.wire.**",
            ],
        },
    ]
    found = {(arrow.source, arrow.target): arrow.only for arrow in architecture.arrows(rules)}
    assert found["ident", "daq"] == ("daq.face", "daq.wire")
    assert found["seatrial", "daq"] == ()
    assert found["mocks", "daq"] == ()
    assert not [pair for pair in found if pair[0] == "daq"]
    assert ("mocks", "ident") not in found
    rules = [{"source_modules": ["daq"], "forbidden_modules": ["plotly"], "ignore_imports": ["daq.x.** -> plotly"]}]
    assert architecture.kept(rules) == [("plotly", ("daq",), ("daq.x",))]
