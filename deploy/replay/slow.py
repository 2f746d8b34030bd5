"""The slow node's part of a process replay: its journal into a fresh deliberation."""

from __future__ import annotations

from collections.abc import Iterator

from deploy.replay.check import Comparison, fields_of
from deploy.replay.tape import Tape
from schemas.wire.journal import Input
from schemas.wire.messages import Directive, Reply
from slow_node.deliberation import Deliberation
from slow_node.effects import Effect
from slow_node.journal import interpretation_of
from slow_node.memory.preferences import Manner
from slow_node.planning.scene import encode_scene
from slow_node.unanswered import RESTARTED


def check_slow(tape: Tape, budget_s: float) -> tuple[Comparison, Comparison]:
    """Directives and replies of the recorded deliberation, had again.

    budget_s: what its interpretations might take. What came behind a gap in its inputs is unchecked.
    """
    directives, replies = Comparison(), Comparison()
    again_directives: dict[int, Directive] = {}
    again_replies: dict[tuple[int, int, str], Reply] = {}
    gaps: list[tuple[int, int]] = []
    for inputs, until_ns in _lives(tape):
        deliberation = Deliberation(budget_s, asks_again=True)
        for one in inputs:
            effects = _feed(deliberation, one, tape)
            if effects is None:
                gaps.append((one.now_ns, until_ns))
                break
            for effect in effects:
                if isinstance(effect, Directive):
                    again_directives[effect.id] = effect
                elif isinstance(effect, Reply):
                    again_replies[effect.stamp_ns, effect.command_id, effect.outcome] = effect
    for directive in tape.directives.values():
        twin = again_directives.get(directive.id)
        if twin is None and _within(gaps, directive.stamp_ns):
            directives.unchecked += 1
            continue
        directives.compare(directive.epoch, directive.scene_tick, fields_of(directive), fields_of(twin) if twin else {})
    for reply in tape.replies:
        if reply.why == RESTARTED:
            continue  # the shell's, of another process
        twin_reply = again_replies.get((reply.stamp_ns, reply.command_id, reply.outcome))
        if twin_reply is None and _within(gaps, reply.stamp_ns):
            replies.unchecked += 1
            continue
        replies.compare(reply.epoch, -1, fields_of(reply), fields_of(twin_reply) if twin_reply else {})
    return directives, replies


def _lives(tape: Tape) -> Iterator[tuple[list[Input], int]]:
    """The inputs of each process that the slow node was, and when its last was over; up to a gap in its numbers."""
    lives: list[list[Input]] = []
    ends: list[int] = []
    expected = 0
    for journal in tape.journals:
        if journal.seq == 0:
            lives.append([])
            ends.append(0)
            expected = 0
        if not lives:
            lives.append(
                [Input(now_ns=journal.stamp_ns)]
            )  # its beginning was not recorded: one that nothing can be fed
            ends.append(0)
        if journal.seq == expected:
            lives[-1] += journal.inputs
            expected += 1
        elif expected >= 0:
            lives[-1].append(Input(now_ns=journal.stamp_ns))
            expected = -1
        ends[-1] = journal.stamp_ns
    return zip(lives, ends, strict=True)


def _feed(deliberation: Deliberation, one: Input, tape: Tape) -> list[Effect] | None:
    """What comes of one input; None where it is not all there."""
    if one.event is not None:
        return deliberation.on_event(one.event, one.now_ns)
    if one.command is not None:
        return deliberation.on_command(one.command, one.now_ns)
    if one.refused is not None:
        return deliberation.refuse_payload(one.refused, one.id, one.now_ns)
    if one.found is not None:
        return deliberation.on_interpretation(one.id, interpretation_of(one.found), one.now_ns)
    if one.manner is not None:
        deliberation.manner = Manner(frozenset(one.manner))
        return []
    observation = tape.observations.get((one.epoch, one.tick))
    return deliberation.on_scene(encode_scene(observation), one.now_ns) if observation is not None else None


def _within(gaps: list[tuple[int, int]], stamp_ns: int) -> bool:
    return any(start <= stamp_ns <= end for start, end in gaps)
