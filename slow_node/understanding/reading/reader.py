"""The program reader: what is sure by its words, and for the rest the intent parser, clause by clause."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import msgspec

from schemas.wire.program import MAX_STEPS, Program, Question, Step, Trigger
from slow_node.understanding.intent_parser import IntentParser, Parsed
from slow_node.understanding.reading.addressed import Addressed
from slow_node.understanding.reading.amounts import amount
from slow_node.understanding.reading.clauses import Clause, clauses, sentences
from slow_node.understanding.reading.lexicon import (
    ON_FOOT,
    RECENT,
    VULNERABLE,
    Found,
    Row,
    bare,
    rows,
    searchable,
    side_said,
)
from slow_node.understanding.reading.questions import question_in
from slow_node.understanding.reading.sequence import before_us, lets, named, not_said_before
from slow_node.understanding.reading.signs import HARMLESS, LIKELY, SIGN, SURE_AS_A_WHOLE, sign, told_by_sign
from slow_node.understanding.reading.standing import standing
from slow_node.understanding.reading.values import corrected, steps_of, unbound, uses_miles
from slow_node.understanding.reading.wishes import about, parted
from slow_node.understanding.slots import Slots

MOST_CLAUSES = 8
"""A longer command is read as a whole."""
MOST_PARSED = 4
"""So many clauses are parsed one by one: each takes the intent parser ten milliseconds."""
_CORRECTS = re.compile(
    r"\b(?:no|nope|nah|wait a|actually|rather|sorry|scratch|false alarm|i mean|i meant|forget|nein|doch nicht|quatsch|moment|non|en fait|"
    r"plutot|pardon|mejor|perdon|anzi|scusa|alias|afinal|nee|toch|laat maar|oder|instead|hmm|oh dear|hold on|never mind)\b"
)
_TAKEN_BACK = re.compile(
    r"(?<=\w), (?:(?:hm+|er|um|uh|oh|ach)[,.]? )*(?:(?:no+|nope|nah|nein|non|nee|nao)(?=,| no\b)|(?:scratch that|sorry|pardon|i mean(?:t)?|on second thoughts?|wait|entschuldigung|perdon|scusa|desculpa|i meant)(?=,| \w))"
)
_DENIED = re.compile(r"\b(?:do ?n[o']?t|dont|not|never|nicht|nie|ne|pas|no|nunca|non|mai|nao|niet|nooit)\b[^,;]{0,20}$")
_AS_IT_IS = re.compile(
    r"^(?:keep|hold|leave|halt\w*|lass|garde|tiens|manten\w*|tieni|mantieni|hou)[ -](?:it|that|es|das|la|le|ca|lo|asi|cosi|dat|het)\b"
)
_OTHERS = re.compile(r"^(?:somebody|someone|some idiot|he|she|they|jemand|quelqu.un|alguien|qualcuno|alguem|iemand)\b")
_HALT = re.compile(
    r"^(?:(?:stop|halt|stopp|anhalten|arrete|arrete-toi|para|parate|detente|alto|fermati|ferma|pare|stoppen)[ ,!]*)+$"
)
"""Beside a warning: it is stopped for it."""
_WHERE = re.compile(
    r"^(?:there |right there |da |dort )?(?:on|in|at|by|along|am|auf|an|im|sur|au|dans|en|sul|sulla|na|no|op|langs) (?:the |der |die |den |dem |la |le |de |het )?"
    r"(?:\w+ )?(?:verge|road|roadside|middle|street|strasse|waldrand|fahrbahn|seite|route|chaussee|bas-cote|carretera|calzada|arcen|strada|ciglio|estrada|berma|weg|berm)$"
)
_BEFORE_ALL = re.compile(r"^(?:before|bevor|ehe|avant|antes|prima|voordat|voor) (?!@)\w+")
_JOINED = re.compile(r"\b(?:and|but|und|aber|et|mais|y|pero|e|ma|mas|en|maar)\b|\d|,")
MOST_SIZE = 30.0
"""A larger number alone is a speed."""
LEFTOVER_WORDS = 4
"""So few words around something sure, and nothing that joins them to it, are how it was said."""
_WAVERS = re.compile(
    r"^(?:(?:no+(?= ?[,.!]| no\b)|nope|nah|naw|actually|hmm+|well|sorry|pardon|wait|whoa|okay|on second thoughts?|nein|nee|na|ach|doch|lieber|doch lieber|"
    r"non|en fait|finalement|anzi|scusa|perdon|afinal|nao|und|and|et|y|e|en|now|jetzt|nu|ora|agora|ahora|bueno|pues)(?!\w)[ ,.!]*)+"
)
"""What a change of mind begins with."""
_POLITE = re.compile(
    r"^(?:if (?:that.s|it.s) (?:ok(?:ay)?|all right|possible)|if you (?:would|could|can)|please)\b[ ,.]*"
)
SAYS = (*rows("others", "says"), *rows("phrases", "says"), *rows("wishes", "says"))
"""What asks for something in so many words."""
_SAYS_NO = re.compile(r"^(?:no|nope|nein|non|nee|nao|ne|oh|hm+|wait|stop|well)$")


@dataclass(frozen=True)
class Reading:
    """What a command was read as."""

    program: Program
    slots: Slots | None
    """The summary, as the intent parser read it; None where it follows from the steps."""
    language: str
    confidence: float
    refused: float
    """Probability that the command is unsafe or an attempt on the system's rules."""
    sure: bool = False
    """It is known by its words, or has what slots cannot say."""


class _Sure(NamedTuple):
    """A wish or a question that is sure by its words, and what else was said in its clause."""

    step: Step | None
    question: Question
    follows: bool
    rest: str


class ProgramReader:
    """Reads commands into programs."""

    def __init__(self, parser: IntentParser) -> None:
        self._parser, self._addressed = parser, Addressed(parser)
        clauses("brake, then after that truck go left in ten seconds")  # compiles the expressions before anybody speaks
        _sure(Clause("brake"))
        standing("brake")
        sign("brake")

    def read(self, command: str, speed_mps: float, limit_mps: float) -> Reading:
        """A command's program, with numbers resolved against the ego's speed and the limit, both in m/s."""
        called = self._addressed.called(command, _known_or_timed)
        if called is not None:
            command = called
        parts = sentences(unbound(command))
        kept = self._addressed.kept(parts, _known, _known_or_timed)
        text = unbound(command) if len(kept) == len(parts) else " ".join(kept)
        if not text:
            return self._talk(command)
        whole = self._parser.parse(text, speed_mps, limit_mps)
        if whole.slots.outcome != "directive" or whole.confidence < SURE_AS_A_WHOLE:
            part = self._addressed.narrowed(text, _known_or_timed, whole.refused >= HARMLESS)
            if part != text:
                text, whole = part, self._parser.parse(part, speed_mps, limit_mps)
        told = None if _known(text) else told_by_sign(text, whole, self._parser, speed_mps, limit_mps)
        if told is not None:
            program = Program(outcome="directive", steps=(told,))
            return Reading(program, None, whole.slots.language, SIGN, 0.0)
        found = [clause for sentence in sentences(text) for clause in clauses(sentence)]
        found = [clause for clause in found if clause.then or not _SAYS_NO.match(clause.text)] or found
        if len(found) > MOST_CLAUSES:
            return self._as_a_whole(command, text, whole, speed_mps)
        at_once = len(found)
        found = [one for clause in found for one in parted(clause, _certain, self._parser, speed_mps, limit_mps)]
        sure = [_sure(clause) for clause in found]
        special = (
            len(found) > at_once or any(sure) or any(clause.when or clause.until or clause.beside for clause in found)
        )
        if not special and not any(clause.then for clause in found):
            return self._as_a_whole(command, text, whole, speed_mps)
        if whole.slots.outcome == "directive" and _corrected(found, any(sure)):
            return self._as_a_whole(command, text, whole, speed_mps)
        return self._clause_by_clause(command, text, whole, found, sure, speed_mps, limit_mps)

    def _talk(self, command: str) -> Reading:
        """Nothing of it is for the car."""
        language = self._parser.parse(command, 0.0, 0.0).slots.language
        slots = Slots(outcome="out_of_scope", language=language)
        return Reading(Program(outcome="out_of_scope"), slots, language, 1.0, 0.0, True)

    def _as_a_whole(self, command: str, text: str, whole: Parsed, speed_mps: float) -> Reading:
        plain = searchable(text)
        slots = corrected(whole.slots, plain)
        steps = steps_of(slots, plain, speed_mps)[:MAX_STEPS]
        program = Program(outcome=slots.outcome, steps=steps, miles=uses_miles(command))
        return Reading(program, slots, slots.language, whole.confidence, whole.refused)

    def _clause_by_clause(
        self,
        command: str,
        text: str,
        whole: Parsed,
        found: list[Clause],
        sure: list[_Sure | None],
        speed_mps: float,
        limit_mps: float,
    ) -> Reading:
        steps: list[Step] = []
        merged = Slots(outcome="directive", language=whole.slots.language)
        questions: list[Question] = []
        known = follows = False
        refused, confidence, parsed, wishes = 0.0, 1.0, 0, 0
        for clause, certain in zip(found, sure, strict=True):
            begins = clause.when or (Trigger(kind="done") if clause.then and steps else None)
            if certain is not None and certain.question:
                questions.append(certain.question)
                continue
            mine: tuple[Step, ...] = ()
            if certain is not None and certain.step is not None:
                if certain.follows and (len(found) > 1 or certain.rest):
                    continue
                mine, known, follows = (certain.step,), True, certain.follows
            rest = clause.text if certain is None else certain.rest
            if mine and mine[0].act == "slower" and _HALT.match(rest):
                mine, rest = (Step(act="stop", object=mine[0].object),), ""
            if (
                certain is not None
                and mine
                and (lets(mine[0]) or any(beside.search(rest) for beside in (_OTHERS, _WHERE, _BEFORE_ALL)))
            ):
                rest = ""  # what others do, and where, is why, and no wish
            if len(rest.split()) > (0 if certain is None else 1) and parsed < MOST_PARSED:
                parsed += 1
                part = self._parser.parse(rest, speed_mps, limit_mps)
                refused = max(refused, part.refused)
                slots = corrected(part.slots, rest)
                if slots.outcome == "directive" and (certain is None or part.confidence > LIKELY):
                    confidence = min(confidence, part.confidence)
                    wishes += 1
                    merged = merged.model_copy(update={**slots.model_dump(exclude_defaults=True, exclude={"outcome"})})
                    mine = (
                        *mine,
                        *(s for s in steps_of(slots, rest, speed_mps) if not mine or about(s) != about(mine[0])),
                    )
            elif not rest and certain is None and clause.when is not None:
                mine = _waited(clause.when)
                if mine:
                    known, begins = True, None
            mine = not_said_before(mine, steps, begins)
            if not mine:
                continue
            if (
                steps
                and steps[-1].act in ("gap", "closer", "farther")
                and mine[0].object == "speed"
                and _AS_IT_IS.search(rest)
            ):
                mine = (Step(act="keep", object="gap"), *mine[1:])
            first = mine[0]
            mine = (msgspec.structs.replace(first, when=begins, until=clause.until), *mine[1:])
            steps += mine
        miles = uses_miles(command)
        language = whole.slots.language
        if not steps and questions:
            program = Program(outcome="out_of_scope", question=questions[0], miles=miles)
            return Reading(program, Slots(outcome="out_of_scope", language=language), language, 1.0, refused, True)
        timed = any(clause.when or clause.until for clause in found)
        if not steps and timed and whole.slots.outcome == "directive":
            return self._all_of_it_later(command, text, whole, found, speed_mps)
        if not steps or (not known and wishes < 2 and not timed):
            return self._as_a_whole(command, text, whole, speed_mps)
        if follows:
            program = Program(outcome="unclear", steps=tuple(steps[:1]), miles=miles)
            label = whole.slots if whole.slots.cancel else Slots(outcome="unclear", language=language)
            return Reading(program, label, language, 1.0, 0.0, True)
        steps = before_us(named(steps, searchable(command)))
        if not known and wishes != len(found) and whole.refused >= HARMLESS and refused >= 0.05:
            refused = whole.refused
        program = Program(outcome="directive", steps=tuple(steps[:MAX_STEPS]), miles=miles)
        summary: Slots | None = None
        if not known:
            summary = merged if timed or whole.slots.outcome != "directive" else whole.slots
        return Reading(program, summary, language, confidence, refused, True)

    def _all_of_it_later(
        self, command: str, text: str, whole: Parsed, found: list[Clause], speed_mps: float
    ) -> Reading:
        """What is clear only as a whole, with what it waits for."""
        reading = self._as_a_whole(command, text, whole, speed_mps)
        when = next((clause.when for clause in found if clause.when), None)
        until = next((clause.until for clause in found if clause.until), None)
        steps = [
            step
            for step in reading.program.steps
            if step.unit != "s" or (when or until or Trigger(kind="done")).kind != "time"
        ]
        if not steps:
            return reading
        steps[0] = msgspec.structs.replace(steps[0], when=when, until=until)
        program = msgspec.structs.replace(reading.program, steps=tuple(steps))
        return Reading(program, whole.slots, reading.language, reading.confidence, reading.refused, True)


def _corrected(found: list[Clause], sure: bool) -> bool:
    """Whether a later word takes back what was said before: then only the whole tells what is left."""
    if any(_TAKEN_BACK.search(clause.text) for clause in found):
        return True
    later = any(_CORRECTS.search(clause.text) for clause in found[1:] if not clause.beside)
    return later or (not sure and _CORRECTS.search(found[0].text, 1) is not None)


def _known_or_timed(sentence: str) -> bool:
    """Whether a sentence says something that is sure by its words, or what is waited for."""
    found = [(_sure(clause), clause) for clause in clauses(sentence)]
    return any((sure is not None and not sure.follows) or clause.when or clause.until for sure, clause in found)


def _known(sentence: str) -> bool:
    """Whether a sentence says something that is sure by its words."""
    return any(_sure(clause) for clause in clauses(sentence))


def _certain(clause: Clause) -> Step | None:
    """The wish that is sure in a clause, and does not go by the one before."""
    sure = _sure(clause)
    return None if sure is None or sure.follows else sure.step


def _waited(trigger: Trigger) -> tuple[Step, ...]:
    """What a clause asks for that says nothing but what to wait for: "wait for that child"."""
    if trigger.kind == "passed" and trigger.object in VULNERABLE:
        return (Step(act="stop", object=trigger.object),)
    return ()


@lru_cache(RECENT)
def _sure(clause: Clause) -> _Sure | None:
    """What is sure in a clause: its whole, its end from some comma on, or one part between commas."""
    parts = [part.strip() for part in clause.text.split(",") if part.strip()]
    spans = (
        [(0, len(parts))]
        + [(i, len(parts)) for i in range(1, len(parts))]
        + [(i, i + 1) for i in range(len(parts) - 1)]
    )
    for start, end in spans:
        candidate = bare(", ".join(parts[start:end]))
        rest = bare(", ".join([*parts[:start], *parts[end:]]))
        if not candidate:
            continue
        question = question_in(candidate, clause.asks)
        if question:
            return _Sure(None, question, False, rest)
        for row in rows("questions", "follows"):
            said = row.match(candidate) or row.match(_WAVERS.sub("", candidate))
            step = None if said is None else _follow_up(row, said.said)
            if step is not None:
                return _Sure(step, "", True, _POLITE.sub("", _WAVERS.sub("", f"{rest} ")).strip())
        changed = None if rest else amount(candidate)
        if changed is not None:
            return _Sure(changed, "", False, "")
        for row in SAYS:
            hit = row.search(candidate) if start == 0 or not row.fields.get("first") else None
            if hit is not None and not _DENIED.search(candidate[: hit.start]):
                left = bare(f"{candidate[: hit.start]} {candidate[hit.end :]}")
                if rest and (row.fields.get("open") or row.fields.get("alone")):
                    continue
                step = Step(act=row.fields["step"]["act"]) if row.fields.get("open") else _step(row, hit)
                if step is not None:
                    says_more = len(left.split()) > LEFTOVER_WORDS or _JOINED.search(left)
                    if says_more and left != candidate:
                        rest = bare(f"{rest} {left}") if len(left.split()) > 2 else rest
                    return _Sure(
                        step, "", row.fields.get("open", False), _without(rest, candidate[hit.start : hit.end])
                    )
    return None


def _without(rest: str, said: str) -> str:
    """The rest without what is only said once more: "brake, brake"."""
    return "" if rest and set(re.split(r"[ ,]+", rest)) <= set(re.split(r"[ ,]+", said)) else rest


def _follow_up(row: Row, said: Mapping[str, str]) -> Step | None:
    """The step that goes by the wish before it; a number without its unit is another size of that."""
    about = row.fields.get("object", "")
    if about != "number":
        return Step(act=row.fields["act"], object=about)
    digits = said["v"].replace(",", ".")
    value = (float(digits) if digits[0].isdigit() else 1.0) + (0.5 if "half" in said else 0.0)
    unit = {"s": "s", "m": "m"}.get(said.get("vu", " ")[0])
    return Step(act="again", object=about, value=value, unit=unit) if value < MOST_SIZE else None  # type: ignore[arg-type]


_OPPOSITE: dict[str | None, Any] = {"left": "right", "right": "left", None: None}


def _step(row: Row, hit: Found) -> Step | None:
    said = hit.said
    fields: dict[str, Any] = dict(row.fields["step"])
    side = side_said(said)
    if fields.get("side") == "away":
        fields["side"] = _OPPOSITE[side] or ("right" if "fast" in said else "left" if "slow" in said else "either")
        fields["count"] = 1
    elif fields.get("side") == "said":
        fields["side"], fields["count"] = side, 1
    elif fields["act"] == "lane" and fields.get("side") != "either" and "object" not in fields:
        number = next((n for n in range(1, 5) if f"o{n}" in said), None) or int(said.get("n", "0"))
        if not 1 <= number <= 8:
            return None
        fields["count"] = number
        over = row.fields["name"] == "lanes over"
        if side is not None:
            fields["side"] = side if over else None if side == "left" else "rightmost"
        elif over:
            return None
    elif side is not None and fields["act"] in ("slower", "stop"):
        fields["side"] = side
    if "who" in said and (said["who"] != "car" or fields["act"] == "yield"):
        fields["object"] = said["who"]
    if fields["act"] == "yield" and fields.get("object") in ON_FOOT:
        fields.pop("side", None)  # who is no car from behind
    return Step(**fields)
