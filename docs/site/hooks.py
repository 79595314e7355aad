"""Hooks of MkDocs.

Pages that are missing in the navigation are added to the section of their folder. Equations are converted to MathML.
The search lists decisions after other pages. Dialogs and parts of the navigation get names for screen readers.
"""

from __future__ import annotations

import html
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

# Folder of a page -> the section of mkdocs.yml that it belongs to.
SECTIONS = {
    "tutorials": "Tutorials",
    "how-to": "How to",
    "examples": "How to",
    "formats": "Files",
    "decisions": "Decisions",
}
ELSEWHERE = "Project"
DECISION_BOOST = 0.1  # factor on the score of a decision in the search, so that pages for users come first


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add missing pages to the navigation, and add the page with the figures of the paper under another name."""
    # MkDocs ignores thesis.html, because the page made from thesis.md has the same name.
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


def on_page_markdown(text: str, page: Page, **_: Any) -> str:
    """Lower the rank of decisions in the search, and return the text of the page unchanged."""
    if page.file.src_uri.startswith("decisions/"):
        page.meta.setdefault("search", {"boost": DECISION_BOOST})
    return text


EMPTY_HEADER = re.compile(r"<th( [^>]*)?></th>")
EQUATION = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(text: str, **_: Any) -> str:
    """Replace each TeX equation by MathML, which browsers show without scripts and without a network.

    An empty corner of a table becomes a cell, because screen readers announce headers.
    """

    def mathml(found: re.Match[str]) -> str:
        # The converter supports the environment align*, GitHub supports aligned inside $$. Both look the same.
        tex = html.unescape(found[2]).strip().replace("{aligned}", "{align*}")
        if found[1] == "div":  # a wide equation scrolls in its own box
            return f'<div class="equation">{convert(tex, display="block")}</div>'
        return str(convert(tex, display="inline"))

    return EMPTY_HEADER.sub(r"<td\1></td>", EQUATION.sub(mathml, text))


# A part of the navigation takes its name from a label. The label is empty if the part has a page of its own.
PART = re.compile(
    r'<nav class="md-nav" data-md-level="\d+" (aria-labelledby="[^"]*")[^>]*>\s*'
    r'<label class="md-nav__title"[^>]*>(?P<title>.*?)</label>',
    re.DOTALL,
)
SEARCH = '<div class="md-search" data-md-component="search" role="dialog">'
CONTENTS = 'aria-label="Table of contents"'
# Lists below a heading in the contents of a page: no landmarks, since headings with the same words may repeat.
CHAPTER = re.compile(r'(<nav class="md-nav") aria-label="[^"]*">')


def on_post_page(text: str, **_: Any) -> str:
    """Name the search, and give each part of the navigation a name that no other part has.

    ValueError is raised if the theme writes these elements in another way.
    """
    if SEARCH not in text:
        raise ValueError("the theme has another search dialog: change SEARCH in docs/site/hooks.py")
    text = text.replace(SEARCH, SEARCH[:-1] + ' aria-label="Search">')

    def named(found: re.Match[str]) -> str:
        title = html.escape(html.unescape(" ".join(re.sub(r"<[^>]*>", " ", found["title"]).split())))
        return found[0].replace(found[1], f'aria-label="{title}"', 1)

    text = PART.sub(named, text)
    if "aria-labelledby" in text:
        raise ValueError("the theme has another navigation: change PART in docs/site/hooks.py")
    text = CHAPTER.sub(r'\1 role="none">', text)
    # The contents of a page are in the navigation for narrow windows and at its side for wide ones.
    return text.replace(CONTENTS, 'aria-label="Contents of this page"', 1) if text.count(CONTENTS) > 1 else text


def on_post_template(text: str, template_name: str, **_: Any) -> str:
    """Name the same parts of the page for addresses that do not exist."""
    return on_post_page(text) if template_name == "404.html" else text


def _paths(nav: Any) -> list[str]:
    """Return all pages in a part of the navigation."""
    if isinstance(nav, str):
        return [nav]
    parts = nav.values() if isinstance(nav, dict) else nav
    return [path for part in parts for path in _paths(part)]


def _section(nav: Any, title: str) -> list[Any] | None:
    """Return the list of pages under a title, at any depth; None if the title does not exist."""
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
