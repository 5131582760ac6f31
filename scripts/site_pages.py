"""What the documentation site has beside docs/: the README, the changelog, the examples and the API, as pages.

A hook of mkdocs: `mkdocs build` (mkdocs.yml). Links to files that are not pages of the site lose their target.
"""

import importlib
import posixpath
import re
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("", "acoustics", "skin", "stimulus", "drive", "hand", "motion", "perception", "instruments", "metrics")
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")


def api(package: str) -> str:
    """The page of a package: its docstring, then each public name."""
    full = f"palmfield.{package}" if package else "palmfield"
    module = importlib.import_module(full)
    names = [name for name in module.__all__ if not name.startswith("__")]
    parts = [f"# {full}", (module.__doc__ or "").strip().split("\n\n")[0]]
    parts += [f"::: {full}.{name}" for name in sorted(names, key=str.lower)]
    return "\n\n".join(parts) + "\n"


def examples() -> str:
    """All examples with their text."""
    parts = ["# Examples", "Each is a file of `examples/` and runs as it stands, from the repository's folder."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        about, code = text.split('"""', 2)[1:]
        name = path.stem[3:].replace("_", " ").capitalize()
        parts.append(f"## {name}\n\n{about.strip()}\n\n```python\n{code.strip()}\n```")
    return "\n\n".join(parts) + "\n"


def generated() -> dict[str, str]:
    """Markdown by path in the site, of all pages that are not files of docs/."""
    pages = {f"api/{package or 'palmfield'}.md": api(package) for package in PACKAGES}
    pages["index.md"] = (ROOT / "README.md").read_text(encoding="utf-8")
    pages["changelog.md"] = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    pages["examples.md"] = examples()
    return pages


def title(path: Path) -> str:
    """The first heading of a page."""
    return next(line[2:].strip() for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("# "))


def on_config(config: Any) -> Any:
    """Add the pages that are many to the navigation."""
    docs = Path(config.docs_dir)
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    reference += [{f"palmfield.{name}" if name else "palmfield": f"api/{name or 'palmfield'}.md"} for name in PACKAGES]
    gallery = sorted((docs / "gallery").rglob("*.md"))
    bench = sorted((docs / "bench").rglob("*.md"))
    for name, pages in (("Gallery", gallery), ("Bench", bench)):
        config.nav.append({name: [{title(page): str(page.relative_to(docs))} for page in pages]})
    config.nav += [{"Roadmap and limits": "roadmap.md"}, {"Changelog": "changelog.md"}]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the pages that are made."""
    for path, text in generated().items():
        files.append(File.generated(config, path, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Point links at the site's pages, and drop those to files that the site doesn't have."""
    here = page.file.src_uri
    # Folder of the page's source in the repository: the README and the changelog lie above docs/
    base = "" if here in ("index.md", "changelog.md") else posixpath.dirname(f"docs/{here}")
    known = {file.src_uri for file in files}

    def mended(found: re.Match[str]) -> str:
        image, text, target = found.groups()
        if "://" in target or target.startswith(("#", "mailto:")):
            return found[0]
        path, _, anchor = target.partition("#")
        at = posixpath.normpath(posixpath.join(base, path))
        at = {"README.md": "docs/index.md", "CHANGELOG.md": "docs/changelog.md"}.get(at, at)
        at = "docs/examples.md" if at in ("examples", "examples/README.md") else at
        inside = at.removeprefix("docs/")
        if not at.startswith("docs/") or inside not in known:
            return text
        there = posixpath.relpath(inside, posixpath.dirname(here) or ".")
        return f"{image}[{text}]({there}{'#' + anchor if anchor else ''})"

    # Code keeps its brackets
    parts = re.split(r"(```.*?```|`[^`\n]*`)", markdown, flags=re.DOTALL)
    return "".join(part if number % 2 else LINK.sub(mended, part) for number, part in enumerate(parts))
