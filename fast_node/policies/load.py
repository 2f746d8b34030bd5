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
from fast_node.policies.fixed import constant_of, random_of
from fast_node.policies.gaps import GapPolicy, read_weights
from fast_node.policies.mlp import BASELINES, LEARNERS, VARIANTS, load_mlp, shipped
from fast_node.policies.outsider import load_outsider, prove
from fast_node.policies.policy import NamedPolicy
from fast_node.policies.rule import RulePolicy
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


def _checkpoint(path: Path, _: str = "") -> NamedPolicy:
    if read_sidecar(path).get("algorithm", "ours") in LEARNERS:
        baseline = load_mlp(path)
        return NamedPolicy(path.name, baseline, sidecar=baseline.sidecar)
    ours = load_attention(path)
    return NamedPolicy(path.name, ours, str(ours.sidecar["mask_preset"]), sidecar=ours.sidecar)


def _ours(_: str) -> NamedPolicy:
    network = _checkpoint(SHIPPED)
    return replace(network, policy=GapPolicy(network.policy, read_weights()))


def _gaps(path: str) -> NamedPolicy:
    network = _checkpoint(SHIPPED)
    return replace(network, policy=GapPolicy(network.policy, read_weights(Path(path)) if path else None))


BUILT_IN: dict[str, Callable[[str], NamedPolicy]] = {
    OURS: _ours,
    "network": partial(_checkpoint, SHIPPED),
    "gaps": _gaps,
    "rule": lambda _: NamedPolicy("rule", RulePolicy()),
    "rule-gaps": lambda _: NamedPolicy("rule-gaps", GapPolicy(RulePolicy(), read_weights())),
    "constant": lambda words: NamedPolicy("constant", constant_of(words)),
    "random": lambda seed: NamedPolicy("random", random_of(seed), stateless=False),
    "blind": lambda _: NamedPolicy("blind", BlindPolicy()),
    "deaf": lambda _: NamedPolicy("deaf", DeafPolicy()),
    "untrained": lambda seed: NamedPolicy("untrained", untrained_of(seed)),
    **{f"{a}-{v}": partial(_checkpoint, shipped(a, v)) for a in BASELINES for v in VARIANTS},
}
"""What every installation has: what comes after the name's colon, to the policy."""
TAKE_MORE = {
    "gaps": "gaps[:FILE]",
    "constant": "constant:ACTION[,ACTION...]",
    "random": "random:SEED",
    "untrained": "untrained:SEED",
}
"""The names that take more after a colon, as messages show them."""
