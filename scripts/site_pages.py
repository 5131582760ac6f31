"""Add pages to the documentation site: README, changelog, examples, notebooks and API.

It is a hook of mkdocs: `mkdocs build` (mkdocs.yml). Equations between dollars become MathML here, which browsers show
without a script. Links to files that are not pages of the site become plain text.
"""

import importlib
import inspect
import json
import posixpath
import re
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from pygments.formatters import HtmlFormatter

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("", "acoustics", "skin", "stimulus", "drive", "hand", "motion", "perception", "instruments", "metrics")
LINK = re.compile(r"(!?)\[([^\]]*)\]\(([^)\s]+)\)")
EQUATION = re.compile(r"\$\$(.+?)\$\$|(?<![\w$\\])\$(?=\S)([^$\n]+?)(?<=\S)\$(?![\w$])", re.DOTALL)
CODE = re.compile(r"(```.*?```|`[^`\n]*`)", re.DOTALL)
PLACE = "equation{}here"
"""Placeholder of an equation while Markdown makes a page, because Markdown does not support MathML."""
EQUATIONS: dict[str, list[str]] = {}
"""Equations of each page, as MathML."""


def api(package: str) -> str:
    """Return the page of a package: its docstring, then each public name."""
    full = f"palmfield.{package}" if package else "palmfield"
    module = importlib.import_module(full)
    names = sorted((name for name in module.__all__ if not name.startswith("__")), key=str.lower)
    rows = [f"| [`{name}`](#{full}.{name}) | {first_line(getattr(module, name))} |" for name in names]
    parts = [f"# {full}", (module.__doc__ or "").strip().split("\n\n")[0]]
    parts += ["\n".join(["| name | what it is |", "|---|---|", *rows])]
    parts += [f"::: {full}.{name}" for name in names]
    return "\n\n".join(parts) + "\n"


def first_line(thing: Any) -> str:
    """Return the first line of a docstring for a cell of a table; empty for values, which have no own docstring."""
    if not (inspect.isroutine(thing) or inspect.isclass(thing) or inspect.ismodule(thing)):
        return ""
    return (inspect.getdoc(thing) or "").strip().split("\n")[0].replace("|", "\\|")


def notebook(path: Path) -> str:
    """Return the cells of a notebook as Markdown, with their output."""
    parts = []
    for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else f"```python\n{source}\n```")
        for output in cell.get("outputs", []):
            parts.append("```text\n" + "".join(output["text"]) + "```")
    return "\n\n".join(parts) + "\n"


def examples() -> str:
    """Return all examples with their text."""
    parts = ["# Examples", "Each is a file of `examples/` and runs as it stands, from the repository's folder."]
    for path in sorted((ROOT / "examples").glob("*.py")):
        text = path.read_text(encoding="utf-8")
        about, code = text.split('"""', 2)[1:]
        name = path.stem[3:].replace("_", " ").capitalize()
        parts.append(f"## {name}\n\n{about.strip()}\n\n```python\n{code.strip()}\n```")
    return "\n\n".join(parts) + "\n"


def generated() -> dict[str, str]:
    """Return Markdown by path in the site, of all pages that are not files of docs/."""
    pages = {f"api/{package or 'palmfield'}.md": api(package) for package in PACKAGES}
    pages["index.md"] = (ROOT / "README.md").read_text(encoding="utf-8")
    pages["changelog.md"] = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    pages["examples.md"] = examples()
    docs = ROOT / "docs"
    pages |= {str(path.relative_to(docs).with_suffix(".md")): notebook(path) for path in docs.rglob("*.ipynb")}
    return pages


def title(path: Path) -> str:
    """Return the first heading of a page."""
    return next(line[2:].strip() for line in path.read_text(encoding="utf-8").splitlines() if line.startswith("# "))


def on_config(config: Any) -> Any:
    """Add the generated pages of a group to the navigation."""
    docs = Path(config.docs_dir)
    reference = next(part["Reference"] for part in config.nav if "Reference" in part)
    reference += [{f"palmfield.{name}" if name else "palmfield": f"api/{name or 'palmfield'}.md"} for name in PACKAGES]
    gallery = sorted((docs / "gallery").rglob("*.md"))
    bench = sorted((docs / "bench").rglob("*.md"))
    for name, pages in (("Gallery", gallery), ("Bench", bench)):
        config.nav.append({name: [{title(page): str(page.relative_to(docs))} for page in pages]})
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    for path, text in generated().items():
        files.append(File.generated(config, path, content=text))
    # Colours of code are in the page, and need no script from elsewhere
    files.append(
        File.generated(config, "pygments.css", content=HtmlFormatter(style="friendly").get_style_defs(".codehilite"))
    )
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Change links to pages of the site, and remove links to files that are not in the site."""
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
        at = at.removesuffix(".ipynb") + ".md" if at.endswith(".ipynb") else at
        inside = at.removeprefix("docs/")
        if not at.startswith("docs/") or inside not in known:
            return text
        there = posixpath.relpath(inside, posixpath.dirname(here) or ".")
        return f"{image}[{text}]({there}{'#' + anchor if anchor else ''})"

    EQUATIONS[here] = []

    def kept(found: re.Match[str]) -> str:
        display, inline = found.groups()
        written = convert((display or inline).strip(), display="block" if display else "inline")
        if "\\" in written:
            raise PluginError(f"{here}: this equation has a command that is not known: {found[0]}")
        EQUATIONS[here].append(f'<div class="equation">{written}</div>' if display else written)
        return PLACE.format(len(EQUATIONS[here]) - 1)

    # Code keeps its brackets and dollars
    parts = CODE.split(markdown)
    parts[::2] = [LINK.sub(mended, EQUATION.sub(kept, part)) for part in parts[::2]]
    return "".join(parts)


def on_page_content(html: str, page: Any, config: Any, files: Files) -> str:
    """Insert the equations; a displayed equation replaces its paragraph."""
    for number, written in enumerate(EQUATIONS.get(page.file.src_uri, ())):
        place = PLACE.format(number)
        html = html.replace(f"<p>{place}</p>", written) if f"<p>{place}</p>" in html else html.replace(place, written)
    return html
