"""Writes docs/files.md: the tree of files, each with the first sentence of its own docstring."""

import ast
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("labdata", "drivers", "simulate", "charact", "benchmarks")
HEADING = """# The tree of files

`labdata` knows nobody; `simulate` and `drivers` know `labdata` and not each other; `charact` stands on
both. Each line is the file's own first sentence. Made by `make docs`; a test keeps it true.
"""


def lines() -> Iterator[str]:
    """The page, line by line."""
    yield HEADING
    for room in ROOMS:
        yield f"\n## {room}\n"
        for path in sorted((ROOT / room).rglob("*.py")):
            if sentence := first_sentence(path):
                yield f"- `{path.relative_to(ROOT).as_posix()}` — {sentence}"


def first_sentence(path: Path) -> str:
    """First paragraph of a module's docstring, on one line; empty for an empty file."""
    text = path.read_text()
    if not text.strip():
        return ""
    docstring = ast.get_docstring(ast.parse(text)) or ""
    return " ".join(docstring.split("\n\n")[0].split())


def page() -> str:
    """The whole page."""
    return "\n".join(lines()) + "\n"


if __name__ == "__main__":
    (ROOT / "docs" / "files.md").write_text(page())
