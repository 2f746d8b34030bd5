"""`make wheel-test`: does the wheel, installed into an environment of its own, drive from somebody else's folder?

That folder has its own `schemas/` and `deploy/`, which nothing may import. Ends with the sizes of both.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
import venv
from pathlib import Path

from deploy.run.model_choice import VARIABLES

ROOT = Path(__file__).parents[1]
NOT_SOURCE = (".*", "runs", "build", "*.egg-info", "__pycache__")
TICKS = 60
"""Of the 75 in five seconds: a busy machine may skip some."""


def run(*command: str | Path, folder: Path, **variables: str) -> str:
    """What a command prints on stdout. Ends the test where it fails."""
    env = {k: v for k, v in os.environ.items() if k not in ("PYTHONPATH", *VARIABLES)} | variables
    done = subprocess.run(command, cwd=folder, env=env, stdout=subprocess.PIPE, text=True, timeout=600, check=False)
    if done.returncode:
        sys.exit(f"{' '.join(map(str, command))}: exit code {done.returncode}\n{done.stdout}")
    return done.stdout


def build(folder: Path) -> Path:
    """The wheel of a clean copy: setuptools would take along what an earlier build has left in the checkout."""
    source = folder / "source"
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(*NOT_SOURCE))
    run(sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", folder, ".", folder=source)
    (wheel,) = folder.glob("fastslow-*.whl")
    return wheel


def install(wheel: Path, folder: Path) -> Path:
    """The folder of the programs of a new environment with the wheel and nothing that it does not ask for."""
    venv.create(folder / "env", with_pip=True)
    programs = folder / "env" / "bin"
    pip = (programs / "python", "-m", "pip")
    run(*pip, "install", "-q", "-c", ROOT / "constraints.txt", str(wheel), folder=folder)
    print(run(*pip, "check", folder=folder).strip())
    return programs


def project(folder: Path) -> Path:
    """Somebody else's project, with packages that are named as ours are."""
    for name in ("schemas", "deploy"):
        package = folder / "project" / name
        package.mkdir(parents=True)
        (package / "__init__.py").write_text(f"raise RuntimeError('this is another {name}')\n", encoding="utf-8")
    return folder / "project"


def drive(programs: Path, folder: Path) -> None:
    """Five seconds. Ends the test where they do not go well."""
    words = ("run", "--port", "0", "--duration", "5", "--json", "--say", "keep more distance", "--say-at", "1")
    # Compiled code goes into a folder of the test's, so that a first start is tested, which compiles.
    mine = {"FASTSLOW_DATA": str(folder / "data"), "NUMBA_CACHE_DIR": str(folder / "compiled")}
    summary = json.loads(run(programs / "fastslow", *words, folder=folder, **mine))
    print({name: summary[name] for name in ("ticks", "answered", "missed", "collisions", "commands", "restarts_of")})
    restarted = {name for name, times in summary["restarts_of"].items() if times}
    if summary["answered"] < TICKS or summary["collisions"] or not summary["commands"] or restarted - {"llm"}:
        sys.exit(f"that was no drive: {json.dumps(summary, indent=2)}")


def make_environments(programs: Path, folder: Path) -> None:
    """Gymnasium finds ours, alone and many at once, without the packages that learn."""
    code = (
        "import gymnasium, sys; name = 'fastslow:fastslow/Highway-v0';"
        "print(gymnasium.make(name).reset(seed=0)[0].shape);"
        "print(gymnasium.make_vec(name, num_envs=2).reset(seed=0)[0].shape);"
        "assert 'torch' not in sys.modules"
    )
    print(run(programs / "python", "-P", "-c", code, folder=folder).strip())


def megabytes(path: Path) -> float:
    files = [path] if path.is_file() else [file for file in path.rglob("*") if file.is_file() and not file.is_symlink()]
    return sum(file.stat().st_size for file in files) / 1e6


def main() -> None:
    with tempfile.TemporaryDirectory(prefix="fastslow-wheel-") as name:
        folder = Path(name)
        wheel = build(folder)
        programs = install(wheel, folder)
        drive(programs, mine := project(folder))
        make_environments(programs, mine)
        print(f"wheel {megabytes(wheel):.1f} MB, environment {megabytes(folder / 'env'):.0f} MB")


if __name__ == "__main__":
    main()
