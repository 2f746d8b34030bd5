"""How big the house is and how tidy: the numbers of `reports/house.md`.

python -m tests.house [FOLDER]     of this checkout, or of another
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

LONG_FILE, LONG_BODY, BLOCK = 400, 60, 8
"""Lines: more are long; so many equal ones in a row, blank lines, imports and brackets apart, are a duplicate."""
BARE = re.compile(
    r"(?<![.\w])(?:row|ego|lead|follower|other|car|lane)\[[1-9]\]"  # a column of a row
    r"|\b(?:rows|lanes|table)\[[^][]*(?:\]\[|, )[1-9]\]"
)
"""A column of a vehicle or a lane by its number instead of its name."""
NOTHING = re.compile(r"(?:#.*|from .*|import .*|\w+,|[\])},]*)$")
Function = ast.FunctionDef | ast.AsyncFunctionDef


def bodies(source: str) -> Iterator[tuple[int, str]]:
    """(lines without signature and docstring, name) of every function."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, Function):
            first = node.body[len(node.body) > 1 and ast.get_docstring(node) is not None]
            yield (node.end_lineno or 0) - first.lineno + 1, node.name


def duplicates(sources: dict[str, str]) -> int:
    """How many blocks of `BLOCK` lines are there more than once; a longer one counts once per line more."""
    blocks: Counter[tuple[str, ...]] = Counter()
    for source in sources.values():
        lines = [line for line in map(str.strip, source.splitlines()) if not NOTHING.match(line)]
        blocks.update({tuple(lines[k : k + BLOCK]) for k in range(len(lines) - BLOCK + 1)})
    return sum(times > 1 for times in blocks.values())


def in_circles(sources: dict[str, str]) -> list[str]:
    """The modules that import each other round about, imports inside functions included."""
    names = {path.removesuffix(".py").removesuffix("/__init__").replace("/", ".") for path in sources}
    imports: dict[str, set[str]] = {}
    for path, source in sources.items():
        found = set()
        for node in ast.walk(ast.parse(source)):
            if isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inner = {f"{node.module}.{alias.name}" for alias in node.names} & names
                found |= inner or {node.module}
        module = path.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
        imports[module] = found & names - {module}
    while True:  # who imports nobody, or is imported by nobody, is in no circle
        wanted = set().union(*imports.values())
        kept = {m: those & imports.keys() for m, those in imports.items() if m in wanted and those & imports.keys()}
        if kept.keys() == imports.keys():
            return sorted(kept)
        imports = kept


def sources_in(root: Path) -> dict[str, str]:
    """What git knows there of Python files, tests apart, by path."""
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=root, capture_output=True, text=True, check=True).stdout
    return {p: (root / p).read_text() for p in listed.split() if (root / p).is_file() and not p.startswith("tests/")}


def main(folder: str = ".") -> None:
    sources = sources_in(Path(folder))
    sizes = {path: source.count("\n") for path, source in sources.items()}
    functions = sorted(((n, f"{p} {name}") for p, s in sources.items() for n, name in bodies(s)), reverse=True)
    long = sum(n > LONG_FILE for n in sizes.values())
    rows = {
        "source files": len(sources),
        "lines": sum(sizes.values()),
        "median lines of a file": sorted(sizes.values())[len(sizes) // 2],
        "rooms (folders with source)": len({Path(path).parent for path in sources}),
        "modules in an import circle": len(in_circles(sources)),
        f"files over {LONG_FILE} lines": f"{long} ({100 * long / len(sizes):.1f} %)",
        "functions": len(functions),
        "longest body": f"{functions[0][0]} ({functions[0][1]})",
        f"bodies over {LONG_BODY} lines": sum(n > LONG_BODY for n, _ in functions),
        "bare column numbers": sum(len(BARE.findall(source)) for source in sources.values()),
        f"duplicate blocks of {BLOCK} lines": duplicates(sources),
    }
    for name, value in rows.items():
        print(f"| {name} | {value} |")
    print(*in_circles(sources), sep="\n")


if __name__ == "__main__":
    main(*sys.argv[1:])
