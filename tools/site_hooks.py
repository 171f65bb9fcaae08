"""Hooks of the documentation's site (`mkdocs.yml`): pages beside the code, and formulas.

The manual links to pages and files outside `docs/`, for instance `../mjcf/README.md`. These links
work on a code host. For the site, the hooks add the linked files to it and rewrite the links.
Nothing is copied in the repository.
"""

from __future__ import annotations

import contextlib
import html
import io
import os
import posixpath
import re
from collections.abc import Iterator
from pathlib import Path

from latex2mathml.converter import convert
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.plugins import event_priority
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

from iits_mj import cli

ROOT = Path(__file__).resolve().parents[1]
CODE_FOLDERS = ("mjcf", "iits_mj", "controllers", "traffic_bridge", "tests", "notebooks")
# A fenced block, code in a line, or the target of a link; only the last has a group.
LINK = re.compile(r"^```.*?^```|`[^`\n]+`|\]\(([^)\s]+)\)|(?:src|href)=\"([^\"]+)\"", re.M | re.S)
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[\[(](.*?)\\[\])]</\1>', re.S)


def pages_beside_the_code() -> list[str]:
    """Returns the pages outside `docs/`, as paths in the repository."""
    manuals = (page for folder in CODE_FOLDERS for page in (ROOT / folder).rglob("*.md"))
    notebooks = (ROOT / "notebooks").glob("*.ipynb")
    others = (ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md")
    return sorted(page.relative_to(ROOT).as_posix() for page in (*manuals, *notebooks, *others))


def commands_page() -> str:
    """Returns the page with the help text of every command."""
    os.environ["COLUMNS"] = "84"  # argparse's width of a line
    parts = ["# Commands", "The help texts. [Driving from the shell](drive.md) is the manual."]
    for name in cli.COMMANDS:
        output = io.StringIO()
        with contextlib.redirect_stdout(output), contextlib.suppress(SystemExit):
            cli.main([name, "--help"])
        parts += [f"## {name}", f"```text\n{output.getvalue().rstrip()}\n```"]
    return "\n\n".join(parts)


def source_of(address: str) -> str:
    """Returns the path in the repository of a file of the site."""
    return address if (ROOT / address).is_file() else f"docs/{address}"


def target_of(link: str, source: str) -> str | None:
    """Returns the path in the repository that a link of the page `source` leads to.

    None stands for other sites, addresses within the page, and files that do not exist.
    """
    path = link.partition("#")[0]
    if not path or "://" in path or path.startswith(("/", "mailto:")):
        return None
    target = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
    if (ROOT / target).is_dir():
        target = f"{target}/README.md"
    return target if (ROOT / target).is_file() else None


def links(text: str) -> Iterator[str]:
    """Yields the links of a page in Markdown."""
    for match in LINK.finditer(text):
        if link := match[1] or match[2]:
            yield link


def file_of(path: str, config: MkDocsConfig) -> File:
    """Returns a file of the repository as a file of the site."""
    return File(path, str(ROOT), config.site_dir, config.use_directory_urls)


@event_priority(100)  # before the plugins, which read notebooks and navigation
def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Adds the pages beside the code, and the files that pages link to."""
    for path in pages_beside_the_code():
        files.append(file_of(path, config))
    files.append(File.generated(config, "commands.md", content=commands_page()))
    for page in [file for file in files if file.src_uri.endswith(".md")]:
        for link in links(page.content_string):
            target = target_of(link, source_of(page.src_uri))
            if target is None or target.startswith("docs/"):
                continue
            if files.get_file_from_path(target) is None and not target.endswith(".md"):
                files.append(file_of(target, config))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Rewrites the page's links from paths in the repository to addresses in the site."""
    address = page.file.src_uri
    source = source_of(address)

    def rewritten(match: re.Match[str]) -> str:
        link = match[1] or match[2]
        target = link and target_of(link, source)
        if not target:
            return match[0]
        path = os.path.relpath(target.removeprefix("docs/"), posixpath.dirname(address) or ".")
        _, mark, anchor = link.partition("#")
        return match[0].replace(link, path + mark + anchor)

    return LINK.sub(rewritten, markdown)


def on_page_content(content: str, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Turns formulas into MathML, which browsers draw without a script."""

    def drawn(match: re.Match[str]) -> str:
        if match[1] == "span":
            return convert(html.unescape(match[2]), display="inline")
        formula = convert(html.unescape(match[2]), display="block")
        return f'<div class="formula">{formula}</div>'

    return FORMULA.sub(drawn, content)
