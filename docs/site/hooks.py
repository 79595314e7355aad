"""Hooks of MkDocs: pages that the navigation does not name go into the section of their folder; equations to MathML."""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

# Folder of a page -> the section of mkdocs.yml that it belongs to.
SECTIONS = {
    "tutorials": "Tutorials",
    "how-to": "How to",
    "examples": "How to",
    "formats": "Files",
    "decisions": "Decisions",
}
ELSEWHERE = "Project"


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Complete the navigation, and keep the page of the paper's figures apart from the page thesis.md becomes."""
    # MkDocs leaves thesis.html out, since thesis.md becomes a page of that name.
    name = "thesis-figures.html"
    figures = File("thesis.html", config.docs_dir, config.site_dir, config.use_directory_urls, dest_uri=name)
    if Path(figures.abs_src_path or "").is_file():
        files.append(figures)
    nav = config.nav or []
    listed = set(_paths(nav))
    for page in sorted(files.documentation_pages(), key=lambda page: page.src_uri):
        if page.src_uri not in listed:
            title = SECTIONS.get(page.src_uri.partition("/")[0], ELSEWHERE)
            section = _section(nav, title)
            if section is None:
                raise ValueError(f"mkdocs.yml: no section {title!r} for docs/{page.src_uri}")
            section.append(page.src_uri)
    return files


EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(text: str, **_: Any) -> str:
    """Replace each equation in TeX by MathML, which browsers draw without a script and without the network."""

    def mathml(found: re.Match[str]) -> str:
        # The converter knows the environment align*, GitHub knows aligned inside of $$; they look the same.
        tex = html.unescape(found[2]).strip().replace("{aligned}", "{align*}")
        return str(convert(tex, display="block" if found[1] == "div" else "inline"))

    return EQUATION.sub(mathml, text)


def _paths(nav: Any) -> list[str]:
    """Every page that a part of the navigation names."""
    if isinstance(nav, str):
        return [nav]
    parts = nav.values() if isinstance(nav, dict) else nav
    return [path for part in parts for path in _paths(part)]


def _section(nav: Any, title: str) -> list[Any] | None:
    """The list of pages under a title, at any depth."""
    if isinstance(nav, dict):
        if isinstance(nav.get(title), list):
            return nav[title]  # type: ignore[no-any-return]
        nav = list(nav.values())
    if isinstance(nav, list):
        for part in nav:
            found = _section(part, title)
            if found is not None:
                return found
    return None
