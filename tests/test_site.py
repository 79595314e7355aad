"""Tests of the documentation site: it builds without a warning, needs no network, and its generated pages are up to
date.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
from latex2mathml.converter import convert

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
