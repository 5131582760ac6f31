"""Write one page for all papers, and convert Markdown to HTML."""

import html
import json
from pathlib import Path

from markdown_it import MarkdownIt

from palmfield_papers.page import NONE
from palmfield_papers.registry import NAMES
from palmfield_papers.verdicts import VERDICTS

LOOK = """body{font-family:system-ui,sans-serif;max-width:75rem;margin:2rem auto;padding:0 1rem;color:#222}
table{border-collapse:collapse;font-size:.85rem;display:block;overflow-x:auto;margin:1rem 0}
th,td{border:1px solid #ccc;padding:.25rem .5rem;text-align:left;vertical-align:top}th{background:#f3f3f3}
img{max-width:100%}code{background:#f3f3f3;padding:0 .2rem}"""


def index(out: Path) -> str:
    """Return Markdown with a line for each paper: a folder of `out` with rows.json. The line has the counts."""
    lines = []
    for name in NAMES:
        path = out / name / "rows.json"
        if not path.is_file():
            continue
        table = json.loads(path.read_text(encoding="utf-8"))
        failed = [control["name"] for control in table["controls"] if not control["works"]]
        cells = (
            f"[{table['title']}]({name}/index.html)", *(str(table["counts"][one]) for one in VERDICTS),
            str(table["counts"]["agrees"] - len(table["weightless"])),
            f"{len(table['controls']) - len(failed)} of {len(table['controls'])}", ", ".join(table["untested"]) or NONE,
            ", ".join(table.get("turned_later", ())) or NONE,
            "quick" if table["quick"] else "full", f"{table.get('seconds', 0.0):.0f}", table["commit"],
        )  # fmt: skip
        lines.append("| " + " | ".join(cells) + " |")
    last = (
        "controls that work",
        "agreeing claims that no control turns",
        "of these turned later",
        "run",
        "s of processor",
        "commit",
    )
    head = ("paper", *VERDICTS, "agreements that carry weight", *last)
    return "\n".join(
        ["# Four papers, computed again", "", "| " + " | ".join(head) + " |", "|" + "---|" * len(head), *lines, ""]
    )


def as_html(title: str, markdown: str, *, home: bool) -> str:
    """Return a self-contained page. home: whether to link to the index one folder up"""
    body = MarkdownIt("commonmark").enable("table").render(markdown)
    back = '<p><a href="../index.html">All papers</a></p>' if home else ""
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{html.escape(title)}</title>'
        f"<style>{LOOK}</style></head><body>{back}{body}</body></html>\n"
    )
