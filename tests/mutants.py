"""Mutation testing: `make mutants` changes one thing at a time in what drives and sees whether a test notices.

The changes are mutmut's, at module level, too, but for those that only types rule out, and one of our own: a condition
that always or never holds. Each mutant runs in a fork of a process that has imported everything but our own code: the
tests of its part, cheapest first, up to the first failure, then the digest of behaviour. A digest says "changed", not
"unsafe": the report counts its kills apart. Survivors are listed with a reason from `mutants.toml`; without one, or
above `MOST`, the command fails.

    python -m tests.mutants [PART ...]     the parts named, or all; each writes its row of the report when it is done
"""

from __future__ import annotations

import gc
import importlib.machinery
import importlib.util
import json
import os
import pickle
import resource
import sys
import tempfile
import time
import tomllib
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

import libcst as cst
import pytest
from hypothesis import HealthCheck, Phase, settings
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation.file_mutation import Mutation, MutationVisitor
from mutmut.mutation.mutators import mutation_operators, operator_assignment
from mutmut.mutation.pragma_handling import IgnoredCode

ROOT = Path(__file__).parents[1]
REPORT = ROOT / "reports/mutants.json"
REASONS = ROOT / "tests/mutants.toml"
"""By file and function, why a change makes no difference."""
MOST = 0.05
"""Of a part's mutants may survive."""
EXAMPLES = 5
"""Of each property."""


class Part(NamedTuple):
    """Code and what judges it."""

    sources: str
    """Pattern of its files."""
    tests: tuple[str, ...]
    """Files and folders, those that notice most for least first."""
    digest: bool = False
    """Whether the digest of behaviour judges, too."""


PARTS = {
    "codec": Part("schemas/wire/codec.py", ("tests/schemas/wire/test_codec.py", "tests/schemas/wire/test_contract.py")),
    "bounds": Part("schemas/wire/bounds.py", ("tests/schemas/wire/test_bounds.py",)),
    "actuator": Part(
        "sim_node/actuator.py", ("tests/sim_node/test_actuator.py", "tests/sim_node/test_actuator_limits.py")
    ),
    "coordination": Part(
        "fast_node/coordination.py",
        (
            "tests/fast_node/test_coordination.py",
            "tests/fast_node/test_coordination_reports.py",
            "tests/fast_node/test_wishes.py",
            "tests/fast_node/test_wishes_pursued.py",
        ),
    ),
    "wishes": Part(
        "fast_node/wishes.py",
        (
            "tests/fast_node/test_wishes.py",
            "tests/fast_node/test_wishes_pursued.py",
            "tests/fast_node/test_coordination.py",
        ),
    ),
    "choice": Part(
        "fast_node/choice.py", ("tests/fast_node/test_choice.py", "tests/fast_node/test_comfort.py"), digest=True
    ),
    "mask": Part(
        "fast_node/mask/[!_]*.py",
        (
            "tests/fast_node/mask/test_limits.py",
            "tests/fast_node/mask/test_formulas.py",
            "tests/fast_node/mask/test_neighbours.py",
            "tests/fast_node/mask",
        ),
        digest=True,
    ),
}
NO_JUDGES = "not the_compiled_mask and not what_its_version_names"
"""No test that compiles with numba, nor the one that holds the digest."""
BY_NOBODY, BY_TESTS, BY_DIGEST, NO_CODE, BROKEN = range(5)
"""Exit statuses of a fork: who has noticed a mutant; that it is no Python; that something in here has failed."""


class Mutant(NamedTuple):
    file: str
    tree: cst.Module
    line: int
    mutation: Mutation

    def source(self) -> str:
        """Of the changed file."""
        tree = self.tree.deep_replace(self.mutation.original_node, self.mutation.mutated_node)
        assert isinstance(tree, cst.Module)
        return tree.code

    def described(self) -> tuple[int, str, str]:
        """The line, the function around it, and what the line was and has become."""
        function = getattr(getattr(self.mutation.contained_by_top_level_function, "name", None), "value", "")
        old, new = self.tree.code.splitlines(), self.source().splitlines()
        line = next((k for k, (a, b) in enumerate(zip(old, new, strict=False)) if a != b), self.line - 1)
        return line + 1, function, f"{old[line].strip()} -> {new[line].strip()}"


def outcome_forced(node: cst.If | cst.CompIf) -> Iterable[cst.CSTNode]:
    """The condition never holds, or always: mutmut has no such change, and it takes a whole rule away."""
    for outcome in ("False", "True"):
        yield node.with_changes(test=cst.Name(outcome))


OPERATORS = [
    *(operator for operator in mutation_operators if operator[1] is not operator_assignment),
    (cst.If, outcome_forced),
    (cst.CompIf, outcome_forced),
]
"""`a = None` for `a = b` is left to the type checker, which notices it."""


def mutants_of(file: str) -> Iterator[Mutant]:
    """All that `OPERATORS` make of a file, but for changes of types, which only the type checker sees."""
    wrapper = MetadataWrapper(cst.parse_module((ROOT / file).read_text()))
    visitor = MutationVisitor(OPERATORS, IgnoredCode(set(), set(), set()))
    tree, place = wrapper.visit(visitor), wrapper.resolve(PositionProvider)
    lines = tree.code.splitlines()
    for mutation in visitor.mutations:
        line = place[mutation.original_node].start.line
        if "TypeVar(" not in lines[line - 1]:
            yield Mutant(file, tree, line, mutation)


class Changed(importlib.machinery.SourceFileLoader):
    """Finds and loads one module of ours from another source."""

    def __init__(self, file: str, code: CodeType) -> None:
        super().__init__(file.removesuffix(".py").replace("/", ".").removesuffix(".__init__"), str(ROOT / file))
        self.code = code

    def find_spec(self, name: str, path: object, target: object = None) -> importlib.machinery.ModuleSpec | None:
        return importlib.util.spec_from_file_location(name, self.path, loader=self) if name == self.name else None

    def get_code(self, fullname: str) -> CodeType:
        return self.code


class Briefly:
    """pytest plugin: hand-made scenes before properties; of each property few examples, the same ones every time."""

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Function]) -> None:
        items.sort(key=lambda item: hasattr(item.obj, "hypothesis"))
        for item in items:
            own = getattr(item.obj, "_hypothesis_internal_use_settings", None)
            if own is not None:
                item.obj._hypothesis_internal_use_settings = settings(
                    own,
                    max_examples=min(own.max_examples, EXAMPLES),
                    derandomize=True,
                    database=None,
                    deadline=None,
                    phases=[Phase.explicit, Phase.generate],
                    suppress_health_check=list(HealthCheck),
                )


def tests_pass(part: Part) -> bool:
    """Whether the tests of a part do, up to the first that does not."""
    quiet = ["-x", "--assert=plain", "--tb=no", "-p", "no:cacheprovider", "-k", NO_JUDGES]
    return all(pytest.main([*quiet, tests], [Briefly()]) == 0 for tests in part.tests)


def judgements(scenes: Sequence[Any]) -> Iterator[tuple[int, ...]]:
    """What mask and choice make of each scene with each preset."""
    from tests import mask_behaviour as behaviour

    for scene in scenes:
        for name in sorted(behaviour.PRESETS):
            yield behaviour.judged(behaviour.Scene(*scene), behaviour.PRESETS[name])


def learn(part: Part, found: str) -> int:
    """Run the unchanged code; write to the file `found` what it imports, its CPU time [s] and its judgements."""
    if not tests_pass(part):
        return BY_TESTS
    scenes: list[Any] = []
    if part.digest:
        from tests import mask_behaviour as behaviour

        scenes = [tuple(scene) for scene in behaviour.draw()]
    result = scenes, list(judgements(scenes)), sorted(sys.modules), time.process_time()
    Path(found).write_bytes(pickle.dumps(result))
    return BY_NOBODY


def judge(mutant: Mutant, part: Part, scenes: Sequence[Any], expected: Sequence[Any]) -> int:
    """Who notices a mutant."""
    try:
        code = compile(mutant.source(), mutant.file, "exec")
    except SyntaxError:
        return NO_CODE
    sys.meta_path.insert(0, Changed(mutant.file, code))
    if not tests_pass(part):
        return BY_TESTS
    try:
        same = all(a == b for a, b in zip(judgements(scenes), expected, strict=True))
    except Exception:
        return BY_DIGEST
    return BY_NOBODY if same else BY_DIGEST


def fork(work: Callable[[], int], cpu_s: float, loud: bool = False) -> int:
    """The id of a process that does `work` and exits with what it returns."""
    pid = os.fork()
    if pid:
        return pid
    status = BROKEN
    try:
        resource.setrlimit(resource.RLIMIT_CPU, (round(cpu_s), round(cpu_s)))
        if not loud:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, 1)
            os.dup2(nowhere, 2)
        status = work()
    finally:
        sys.stdout.flush()
        os._exit(status)


def run(name: str) -> tuple[list[Mutant], list[int]]:
    """The mutants of a part and who noticed each."""
    part = PARTS[name]
    with tempfile.NamedTemporaryFile() as found:
        pid = fork(partial(learn, part, found.name), 600, loud=True)
        if os.waitpid(pid, 0)[1] != 0:
            raise SystemExit(f"{name}: the tests of the unchanged code fail")
        scenes, expected, modules, cpu_s = pickle.load(found)
    ours = {path.name for path in ROOT.iterdir()}
    for module in modules:
        if module.partition(".")[0] not in ours and not module.startswith("_"):
            try:
                importlib.import_module(module)
            except ImportError:  # made by hand when another was imported
                pass
    mutants = [m for path in sorted(ROOT.glob(part.sources)) for m in mutants_of(str(path.relative_to(ROOT)))]
    verdicts = [NO_CODE] * len(mutants)
    gc.freeze()  # the forks share what there is
    waiting, running, began = list(range(len(mutants)))[::-1], dict[int, int](), time.monotonic()
    while waiting or running:
        while waiting and len(running) < len(os.sched_getaffinity(0)):
            k = waiting.pop()
            pid = fork(partial(judge, mutants[k], part, scenes, expected), 5.0 * cpu_s + 10.0)
            running[pid] = k
        pid, status = os.wait()
        # One that loops is ended by the limit of its CPU time.
        verdicts[k := running.pop(pid)] = os.WEXITSTATUS(status) if os.WIFEXITED(status) else BY_TESTS
        if verdicts[k] == BROKEN:
            raise SystemExit(f"{name}: {mutants[k].described()} could not be judged")
        if verdicts[k] == BY_NOBODY:
            print(f"{name}: {mutants[k].file}:{mutants[k].described()} survives", flush=True)
        done = len(mutants) - len(waiting) - len(running)
        if done % 50 == 0 or done == len(mutants):
            print(f"{name}: {done} of {len(mutants)} mutants, {time.monotonic() - began:.0f} s", flush=True)
    return mutants, verdicts


def row_of(name: str) -> dict[str, Any]:
    """A part's row of the report."""
    known = tomllib.loads(REASONS.read_text())
    mutants, verdicts = run(name)
    listed = []
    for mutant in (m for m, by in zip(mutants, verdicts, strict=True) if by == BY_NOBODY):
        line, function, change = mutant.described()
        reason = known.get(f"{mutant.file} {function}".strip(), {}).get(change, "")
        listed.append({"where": f"{mutant.file}:{line}", "change": change, "reason": reason})
    return {
        "module": PARTS[name].sources,
        "mutants": len(mutants) - verdicts.count(NO_CODE),
        "survived": len(listed),
        "killed_by_digest_only": verdicts.count(BY_DIGEST),
        "listed": listed,
    }


def write(row: dict[str, Any]) -> None:
    """Put a part's row into the report, in the place of its last one."""
    rows: dict[str, dict[str, Any]] = {part.sources: {} for part in PARTS.values()}
    if REPORT.exists():
        rows |= {old["module"]: old for old in json.loads(REPORT.read_text())["rows"] if old["module"] in rows}
    rows[row["module"]] = row
    REPORT.parent.mkdir(exist_ok=True)
    report = {"schema": "mutants/1", "rows": [known for known in rows.values() if known]}
    REPORT.write_text(json.dumps(report, indent=1, ensure_ascii=False) + "\n")


def main(names: Sequence[str]) -> int:
    unknown = sorted(set(names) - set(PARTS))
    if unknown:
        raise SystemExit(f"no part {', '.join(unknown)}; there are {', '.join(PARTS)}")
    rows: list[dict[str, Any]] = []
    faults: list[str] = []
    for name in names or PARTS:
        rows.append(row := row_of(name))
        write(row)
        unexplained = [f"{r['where']}: {r['change']}" for r in row["listed"] if not r["reason"]]
        faults += unexplained
        if row["survived"] > MOST * row["mutants"]:
            faults.append(f"{row['module']}: {row['survived']} of {row['mutants']} survive")
    for row in rows:
        print({k: v for k, v in row.items() if k != "listed"})
    print(*faults, sep="\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
