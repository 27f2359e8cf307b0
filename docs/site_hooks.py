"""Hooks of the documentation site (mkdocs.yml): pages for files of the repository that the pages link to.

The pages are read in the repository too, where links such as ``../recipes/quickstart.yaml`` lead to files outside
docs/. On the site each of these files is a page with its text, so that no link needs a network.
"""

from __future__ import annotations

import json
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
_PROJECT = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md", "third_party.md": "THIRD_PARTY.md"}
_NOTEBOOK = ("tutorials/notebook.md", "forest.ipynb")
_LINK = re.compile(r"(?<=\]\()([^)\s#]+)(#[^)\s]*)?(?=\))")
_SHOWN = (".yaml", ".py", ".lsys", ".sys", ".csv", ".toml", ".md", ".ipynb")  # endings of a folder's listed files
_places: dict[str, str] = {}  # address of a page on the site -> path in the repository that its links are relative to


def on_config(config: Any) -> Any:
    """Folders in the navigation, written with a slash at their end, are replaced by their pages."""
    config.nav = [_expanded(one, Path(config.docs_dir)) for one in config.nav]
    return config


def _expanded(entry: Any, docs: Path) -> Any:
    if isinstance(entry, list):
        return [_expanded(one, docs) for one in entry]
    if isinstance(entry, dict):
        return {title: _expanded(one, docs) for title, one in entry.items()}
    if entry.endswith("/"):
        return [f"{entry}{path.name}" for path in sorted((docs / entry).glob("*.md"))]
    return entry


def on_files(files: Files, config: Any) -> Files:
    """Add the project's own pages, the notebook, and every file outside docs/ that a page links to."""
    _places.clear()
    _places.update({file.src_uri: f"docs/{file.src_uri}" for file in files.documentation_pages()})
    texts = {_places[file.src_uri]: file.content_string for file in files.documentation_pages()}
    for address, name in _PROJECT.items():
        if (ROOT / name).exists():
            texts[name] = (ROOT / name).read_text(encoding="utf-8")
            _places[address] = name
            files.append(File.generated(config, address, content=texts[name]))
    address, name = _NOTEBOOK
    _places[address] = f"docs/{name}"
    files.append(File.generated(config, address, content=_notebook(ROOT / "docs" / name)))
    outside = {path for place, text in texts.items() for path in _outside(place, text)}
    listed = {inner for path in outside for inner in _listed(path)}
    for path in sorted(outside | listed):
        files.append(File.generated(config, _page_of(path), content=_page(path)))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Lead links to files of the repository to their pages."""
    here = page.file.src_uri
    if here not in _places:
        return markdown
    known = {place: address for address, place in _places.items() if address != _NOTEBOOK[0]}

    def on_site(link: re.Match[str]) -> str:
        path = _path(_places[here], link[1])
        if path is None:
            return link[0]
        address = known.get(path) or (path.removeprefix("docs/") if path.startswith("docs/") else _page_of(path))
        return posixpath.relpath(address, posixpath.dirname(here) or ".") + (link[2] or "")

    return _LINK.sub(on_site, markdown)


def _path(place: str, link: str) -> str | None:
    """The path in the repository that a link of the file `place` leads to; None: it leads elsewhere, or nowhere."""
    if ":" in link:
        return None
    path = posixpath.normpath(posixpath.join(posixpath.dirname(place), link))
    return path if not path.startswith("..") and (ROOT / path).exists() else None


def _outside(place: str, text: str) -> set[str]:
    paths = {_path(place, link[1]) for link in _LINK.finditer(text)}
    return {path for path in paths if path and not path.startswith("docs/") and path not in _PROJECT.values()}


def _listed(path: str) -> list[str]:
    """Files of a folder, whose page lists them."""
    if not (ROOT / path).is_dir():
        return []
    return [f"{path}/{one.name}" for one in sorted((ROOT / path).iterdir()) if one.suffix in _SHOWN]


def _page_of(path: str) -> str:
    return f"repository/{path}/index.md" if (ROOT / path).is_dir() else f"repository/{path}.md"


def _page(path: str) -> str:
    if (ROOT / path).is_dir():
        names = [posixpath.basename(one) for one in _listed(path)]
        return f"# {path}\n\n" + "\n".join(f"- [{name}]({name}.md)" for name in names) + "\n"
    text = (ROOT / path).read_text(encoding="utf-8").rstrip()
    language = {".py": "python", ".yaml": "yaml", ".toml": "toml"}.get(posixpath.splitext(path)[1], "text")
    return f"# {path}\n\n````{language}\n{text}\n````\n"


def _notebook(path: Path) -> str:
    """The cells of a notebook as a page."""
    text = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        text.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
    text.insert(1, f"The cells of [{path.name}](../{path.name}), which Jupyter opens.")
    return "\n\n".join(text) + "\n"
