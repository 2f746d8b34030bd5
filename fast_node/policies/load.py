"""Where every policy is found: by a built-in name, a checkpoint's path, or `package.module:factory`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

from fast_node.mask import PRESETS
from fast_node.policies.ablated import BlindPolicy, DeafPolicy, untrained_of
from fast_node.policies.attention import SHIPPED, load_attention
from fast_node.policies.checkpoint import read_sidecar
from fast_node.policies.courses import COURSES, CoursePolicy
from fast_node.policies.fixed import constant_of, random_of
from fast_node.policies.gaps import GAPS, GapPolicy
from fast_node.policies.mlp import BASELINES, LEARNERS, VARIANTS, load_mlp, shipped
from fast_node.policies.outsider import load_outsider, prove
from fast_node.policies.policy import NamedPolicy
from fast_node.policies.rule import RulePolicy
from schemas.driving.features import Array
from schemas.runtime.process import ConfigError

OURS = "fastslow"


def load_policy(spec: str = OURS) -> NamedPolicy:
    """The policy that `spec` names. Raises `ConfigError` that names the fix.

    `spec`: a name of `BUILT_IN`, some of which take more ("constant:faster,left", "random:7"); the path of a checkpoint
    that was trained here, ours or a baseline's; or "package.module:factory", a callable that returns a `Policy`.
    """
    name, colon, more = spec.partition(":")
    if name in BUILT_IN and (name in TAKE_MORE or not colon):
        found = BUILT_IN[name](more)
    elif spec.endswith(".safetensors") or "/" in spec:
        found = _checkpoint(Path(spec))
    elif name and more and name not in BUILT_IN:
        found = load_outsider(spec)
    else:
        names = ", ".join(TAKE_MORE.get(name, name) for name in BUILT_IN)
        raise ConfigError(
            f"no policy {spec!r}: choose from {names}; or give a checkpoint's path (FILE.safetensors) or module:factory"
        )
    if found.mask_preset not in PRESETS:
        raise ConfigError(f"policy {spec} has mask_preset {found.mask_preset!r}: choose from {', '.join(PRESETS)}")
    if found.stateless:  # to ask one that remembers would change what it does next
        prove(spec, found)
    return replace(found, name=spec)


def files_of(spec: str = OURS) -> tuple[Path, ...]:
    """What the policy that `spec` names is read from, whether or not it is there; none for a rule or a module."""
    name, _, more = spec.partition(":")
    given = (Path(more),) if more else ()
    if name in (OURS, "blind", "deaf"):
        return SHIPPED, COURSES.shipped, GAPS.shipped
    if name == "courses":
        return SHIPPED, *given, GAPS.shipped
    if name == "gaps":
        return SHIPPED, COURSES.shipped, *given
    if name == "rule-choices":
        return COURSES.shipped, GAPS.shipped
    if name == "network":
        return (SHIPPED,)
    if name in BUILT_IN:
        return tuple(shipped(a, v) for a in BASELINES for v in VARIANTS if name == f"{a}-{v}")
    return (Path(spec),) if spec.endswith(".safetensors") or "/" in spec else ()


def _checkpoint(path: Path, _: str = "") -> NamedPolicy:
    if read_sidecar(path).get("algorithm", "ours") in LEARNERS:
        baseline = load_mlp(path)
        return NamedPolicy(path.name, baseline, sidecar=baseline.sidecar)
    ours = load_attention(path)
    return NamedPolicy(path.name, ours, str(ours.sidecar["mask_preset"]), sidecar=ours.sidecar)


def _chosen(base: NamedPolicy, courses: Array | None, gaps: Array | None) -> NamedPolicy:
    """The shipped driver's two choices over a base policy: of a lane and a speed, and of a gap to change into."""
    return replace(base, policy=GapPolicy(CoursePolicy(base.policy, courses), gaps))


def _ours(_: str) -> NamedPolicy:
    return _chosen(_checkpoint(SHIPPED), COURSES.read(), GAPS.read())


def _courses(path: str) -> NamedPolicy:
    return _chosen(_checkpoint(SHIPPED), COURSES.read(Path(path)) if path else None, GAPS.read())


def _gaps(path: str) -> NamedPolicy:
    return _chosen(_checkpoint(SHIPPED), COURSES.read(), GAPS.read(Path(path)) if path else None)


def _rule(_: str = "") -> NamedPolicy:
    return NamedPolicy("rule", RulePolicy())


BUILT_IN: dict[str, Callable[[str], NamedPolicy]] = {
    OURS: _ours,
    "network": partial(_checkpoint, SHIPPED),
    "courses": _courses,
    "gaps": _gaps,
    "rule": _rule,
    "rule-choices": lambda _: _chosen(_rule(), COURSES.read(), GAPS.read()),
    "constant": lambda words: NamedPolicy("constant", constant_of(words)),
    "random": lambda seed: NamedPolicy("random", random_of(seed), stateless=False),
    "blind": lambda _: NamedPolicy("blind", BlindPolicy(_ours("").policy)),
    "deaf": lambda _: NamedPolicy("deaf", DeafPolicy(_ours("").policy)),
    "untrained": lambda seed: NamedPolicy("untrained", untrained_of(seed)),
    **{f"{a}-{v}": partial(_checkpoint, shipped(a, v)) for a in BASELINES for v in VARIANTS},
}
"""What every installation has: what comes after the name's colon, to the policy."""
TAKE_MORE = {
    "courses": "courses[:FILE]",
    "gaps": "gaps[:FILE]",
    "constant": "constant:ACTION[,ACTION...]",
    "random": "random:SEED",
    "untrained": "untrained:SEED",
}
"""The names that take more after a colon, as messages show them."""
