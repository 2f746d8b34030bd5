"""The program reader: each expression knows its own words and no others, and commands of its kinds become programs."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from schemas.wire.program import Program, plain
from slow_node.llm.embedding import load_embedder
from slow_node.understanding.intent_parser import IntentParser
from slow_node.understanding.reading.lexicon import Row, bare, rows, searchable
from slow_node.understanding.reading.reader import ProgramReader

GROUPS = (
    ("others", "says"),
    ("phrases", "says"),
    ("wishes", "says"),
    ("questions", "asks"),
    ("questions", "follows"),
    ("tales", "tells"),
    ("topics", "topics"),
    ("triggers", "waits"),
    ("signs", "signs"),
    ("scenes", "signs"),
)
ROWS = [(group, row) for name, group in GROUPS for row in rows(name, group)]


def named(value: object) -> str:
    if not isinstance(value, Row):
        return str(value)
    return "-".join(
        str(value.fields[key]) for key in ("name", "question", "act", "kind", "until") if key in value.fields
    )


@pytest.mark.parametrize(("group", "row"), ROWS, ids=named)
def test_an_expression_matches_its_commands_in_every_language_and_not_those_beside_them(group: str, row: Row) -> None:
    def hits(command: str) -> bool:
        text = searchable(command) if group in ("waits", "signs", "tells") else bare(searchable(command))
        if group == "follows":
            return any(pattern.fullmatch(text) for pattern in row.patterns)
        return row.search(text) is not None

    assert [command for command in row.fields["matches"] if not hits(command)] == []
    assert [command for command in row.fields["passes"] if hits(command)] == []


@pytest.fixture(scope="module")
def reader() -> ProgramReader:
    parser = IntentParser.load(load_embedder())
    if parser is None:
        pytest.skip("MiniLM or the parser's weights are not installed")
    return ProgramReader(parser)


def read(reader: ProgramReader, command: str) -> Program:
    return reader.read(command, 25.0, 33.0).program


def steps(reader: ProgramReader, command: str) -> list[dict[str, Any]]:
    return [plain(step) for step in read(reader, command).steps]


KMH_10 = pytest.approx(2.778, abs=0.01)

CHANGES = {
    "ten metres more room": {"act": "farther", "value": 10.0, "unit": "m", "mode": "by"},
    "Leave another fifteen metres to the car ahead": {"act": "farther", "value": 15.0, "unit": "m", "mode": "by"},
    "zehn Meter mehr Abstand": {"act": "farther", "value": 10.0, "unit": "m", "mode": "by"},
    "mach den Abstand um zehn Meter größer": {"act": "farther", "value": 10.0, "unit": "m", "mode": "by"},
    "two car lengths more, please": {"act": "farther", "value": 10.0, "unit": "m", "mode": "by"},
    "keep four car lengths": {"act": "gap", "value": 20.0, "unit": "m", "mode": "to"},
    "I want at least fifty metres to that van": {"act": "gap", "value": 50.0, "unit": "m", "mode": "at_least"},
    "at least ninety": {"act": "drive", "value": 25.0, "unit": "mps", "mode": "at_least"},
    "Mindestens neunzig bitte": {"act": "drive", "value": 25.0, "unit": "mps", "mode": "at_least"},
    "no more than 90 here": {"act": "drive", "value": 25.0, "unit": "mps", "mode": "at_most"},
    "Höchstens 90": {"act": "drive", "value": 25.0, "unit": "mps", "mode": "at_most"},
    "ten km/h slower": {"act": "slower", "value": KMH_10, "unit": "mps", "mode": "by"},
    "slow down by 10": {"act": "slower", "value": KMH_10, "unit": "mps", "mode": "by"},
    "slow down to 90": {"act": "slower", "value": 25.0, "unit": "mps", "mode": "to"},
    "half the speed": {"act": "slower", "value": 0.5, "unit": "times", "mode": "factor"},
    "fahr halb so schnell": {"act": "slower", "value": 0.5, "unit": "times", "mode": "factor"},
    "double the gap": {"act": "farther", "value": 2.0, "unit": "times", "mode": "factor"},
    "twenty percent slower": {"act": "slower", "value": 0.8, "unit": "times", "mode": "factor"},
}
BOUND_ELSEWHERE = {
    "it is 40 degrees in here, get us home quickly": {"act": "faster"},
    "bus 42 leaves soon, hurry": {"act": "faster"},
    "The 70 bus is right behind us, go faster": {"act": "faster"},
    "keep 90 once we're on the motorway": {"act": "drive", "value": 25.0, "unit": "mps", "mode": "to"},
}
WHO_ACTS = {
    "get out of the left lane": {"act": "lane", "side": "right", "count": 1},
    "runter von der linken Spur": {"act": "lane", "side": "right", "count": 1},
    "let that truck in": {"act": "yield", "object": "truck"},
    "Lass den Bus einscheren": {"act": "yield", "object": "bus"},
    "make way for the ambulance": {"act": "yield", "object": "ambulance", "side": "right"},
    "laisse passer l'ambulance": {"act": "yield", "object": "ambulance", "side": "right"},
    "watch out, a cyclist on the right": {
        "act": "slower", "object": "cyclist", "side": "right", "value": 0.8, "unit": "times", "mode": "factor",
    },
    "¡Cuidado con el ciclista!": {
        "act": "slower", "object": "cyclist", "value": 0.8, "unit": "times", "mode": "factor",
    },
    "Don't let that van squeeze in.": {"act": "yield", "object": "van", "polarity": "not"},
    "Ambulance behind us, let it through.": {"act": "yield", "object": "ambulance", "side": "right"},
    "Lass die Kinder erst rübergehen": {"act": "yield", "object": "child"},
    "He can go first, the bus.": {"act": "yield", "object": "bus"},
    "Stop, there's somebody on the crossing!": {"act": "stop"},
    "brake!": {"act": "slower", "value": 0.5, "unit": "times", "mode": "factor"},
    "stop for the pedestrian": {"act": "stop", "object": "pedestrian"},
    "Halt für die Fußgänger an": {"act": "stop", "object": "pedestrian"},
    "do not exceed the limit": {"act": "drive", "object": "limit", "mode": "at_most"},
    "drive straight on at the crossing": {"act": "keep", "object": "lane"},
}  # fmt: skip
LANES = {
    "take the third lane": {"act": "lane", "count": 3},
    "die zweite Spur von rechts bitte": {"act": "lane", "side": "rightmost", "count": 2},
    "two lanes over to the left": {"act": "lane", "side": "left", "count": 2},
    "twee rijstroken naar rechts": {"act": "lane", "side": "right", "count": 2},
    "change lanes, left or right, I don't mind": {"act": "lane", "side": "either"},
}
LATER = {
    "in ten seconds slow down": {"act": "slower", "when": {"kind": "time", "value": 10.0}},
    "In zehn Sekunden bitte auf die linke Spur": {
        "act": "lane", "side": "left", "count": 1, "when": {"kind": "time", "value": 10.0},
    },
    "dans 300 mètres, mets-toi à droite": {
        "act": "lane", "side": "right", "count": 1, "when": {"kind": "distance", "value": 300.0},
    },
    "if the left lane is free, go left": {
        "act": "lane", "side": "left", "count": 1, "when": {"kind": "free", "side": "left"},
    },
    "Cuando la izquierda esté libre, cámbiate": {
        "act": "lane", "side": "left", "count": 1, "when": {"kind": "free", "side": "left"},
    },
    "after that truck, change lanes to the left": {
        "act": "lane", "side": "left", "count": 1, "when": {"kind": "passed", "object": "truck"},
    },
    "wait until the oncoming car has passed, then overtake": {
        "act": "overtake", "when": {"kind": "passed", "object": "oncoming"},
    },
    "stay behind that bus until the exit": {
        "act": "overtake", "object": "bus", "polarity": "not", "until": {"kind": "exit"},
    },
    "drive at 90 for twenty seconds": {
        "act": "drive", "value": 25.0, "unit": "mps", "mode": "to", "until": {"kind": "time", "value": 20.0},
    },
}  # fmt: skip


@pytest.mark.parametrize("kind", ["changes", "bound", "who", "lanes", "later"])
def test_a_command_of_one_step_is_read_as_it_is_meant(reader: ProgramReader, kind: str) -> None:
    kinds = {"changes": CHANGES, "bound": BOUND_ELSEWHERE, "who": WHO_ACTS, "lanes": LANES, "later": LATER}
    cases: dict[str, Any] = kinds[kind]  # type: ignore[assignment]
    wrong = {command: steps(reader, command) for command, step in cases.items() if steps(reader, command) != [step]}
    assert wrong == {}


DONE = {"kind": "done"}
LEFT = {"act": "lane", "side": "left", "count": 1}
RIGHT = {"act": "lane", "side": "right", "count": 1}
IN_WORDS = {
    "Give it half a minute and then move over to the right": [{**RIGHT, "when": {"kind": "time", "value": 30.0}}],
    "Resta in questa corsia ancora 2 miglia": [
        {"act": "keep", "object": "lane", "until": {"kind": "distance", "value": 3218.6}}
    ],
    "Sigue en este carril otras 3 millas": [
        {"act": "keep", "object": "lane", "until": {"kind": "distance", "value": 4827.9}}
    ],
    "In about a kilometre, get into the right lane": [{**RIGHT, "when": {"kind": "distance", "value": 1000.0}}],
    "Keep this speed for another mile": [
        {"act": "keep", "object": "speed", "until": {"kind": "distance", "value": 1609.3}}
    ],
    "Move left, and when you're there slow down": [LEFT, {"act": "slower", "when": DONE}],
    "Change to the right lane before you slow down": [RIGHT, {"act": "slower", "when": DONE}],
    "Überhol den Wagen und ordne dich danach wieder rechts ein": [{"act": "overtake"}, {**RIGHT, "when": DONE}],
    "Knock off twenty": [{"act": "slower", "value": 5.556, "unit": "mps", "mode": "by"}],
    "Go a third faster": [{"act": "faster", "value": 1.333, "unit": "times", "mode": "factor"}],
    "a bit faster": [{"act": "faster", "object": "bit"}],
    "Cap it at 100": [{"act": "drive", "value": 27.778, "unit": "mps", "mode": "at_most"}],
    "Don't let it drop under 80": [{"act": "drive", "value": 22.222, "unit": "mps", "mode": "at_least"}],
    "Vacate the left lane, somebody's in a hurry back there": [RIGHT],
    "That lorry wants in, be a sport and let it": [{"act": "yield", "object": "truck"}],
}


IN_WORDS |= {
    "An extra second of distance, please": [{"act": "farther", "value": 1.0, "unit": "s", "mode": "by"}],
    "Venti metri in più da quello davanti": [{"act": "farther", "value": 20.0, "unit": "m", "mode": "by"}],
    "Ten car lengths, nothing less": [{"act": "gap", "value": 50.0, "unit": "m", "mode": "at_least"}],
    "Fahr ein Drittel langsamer": [{"act": "slower", "value": 0.667, "unit": "times", "mode": "factor"}],
    "Baja la velocidad un veinte por ciento": [{"act": "slower", "value": 0.8, "unit": "times", "mode": "factor"}],
    "Mindestens achtzig, aber nicht mehr als hundert": [
        {"act": "drive", "value": 22.222, "unit": "mps", "mode": "at_least"},
        {"act": "drive", "value": 27.778, "unit": "mps", "mode": "at_most"},
    ],
    "When you see a hole in the right lane, slip into it": [{**RIGHT, "when": {"kind": "free", "side": "right"}}],
    "Quando não vier ninguém de frente, ultrapassa": [{"act": "overtake", "when": {"kind": "clear"}}],
    "Get by this one and after that tuck back in on the right": [{"act": "overtake"}, {**RIGHT, "when": DONE}],
    "When we hit a hundred, hold it there": [
        {"act": "keep", "object": "speed", "when": {"kind": "speed", "value": pytest.approx(27.778, abs=0.01)}}
    ],
    "Dans un kilomètre et demi, à droite": [{**RIGHT, "when": {"kind": "distance", "value": 1500.0}}],
}


@pytest.mark.parametrize(
    "command",
    [
        "My shift starts in ten minutes",
        "omg my flight boards in 25 min",
        "Kick-off's in half an hour and I've still got to find my seat!",
        "El partido empieza en diez minutos",
        "Il negozio chiude tra dieci minuti",
        "In zwanzig Minuten fängt die Prüfung an",
        "Half my espresso is now on the contract",
        "We have been behind this tractor for five minutes",
    ],
)
def test_a_time_or_a_part_that_is_only_told_is_no_condition_and_no_factor(reader: ProgramReader, command: str) -> None:
    told = read(reader, command).steps
    assert [step for step in told if step.when or step.until or step.mode == "factor"] == []


@pytest.mark.parametrize("command", IN_WORDS)
def test_amounts_in_words_and_order_in_any_order_are_read(reader: ProgramReader, command: str) -> None:
    assert steps(reader, command) == IN_WORDS[command]


@pytest.mark.parametrize("command", ["Change lanes", "Wechsel mal die Spur", "Change de voie", "Cambia de carril"])
def test_a_lane_change_without_its_side_is_unclear_and_says_so(reader: ProgramReader, command: str) -> None:
    assert plain(read(reader, command)) == {"outcome": "unclear", "steps": [{"act": "lane"}]}


@pytest.mark.parametrize(
    "command",
    [
        "first overtake, then go right",
        "Pass him, and after that move to the right lane",
        "Überhol den und fahr danach wieder rechts",
        "Adelántalo y luego vuelve a la derecha",
        "Prima sorpassa, poi torna a destra",
        "Ultrapassa-o e depois volta para a direita",
        "Dépasse-le, puis remets-toi à droite",
        "Haal hem in en ga dan naar rechts",
    ],
)
def test_one_thing_after_the_other_waits_for_the_one_before(reader: ProgramReader, command: str) -> None:
    assert steps(reader, command) == [{"act": "overtake"}, {"act": "lane", "side": "right", "count": 1, "when": DONE}]


@pytest.mark.parametrize(
    ("command", "question"),
    [
        ("how fast are we?", "speed"),
        ("Tell me, how fast are we going?", "speed"),
        ("why don't you overtake?", "why_not_overtake"),
        ("Warum überholst du nicht?", "why_not_overtake"),
        ("what are you waiting for?", "waiting"),
        ("is it safe?", "safe"),
        ("Wie schnell darf man hier?", "limit"),
        ("à quelle vitesse on roule ?", "speed"),
        ("¿por qué vamos tan despacio?", "why_slow"),
        ("in che corsia siamo?", "lane"),
        ("a que distância estamos do carro da frente?", "gap"),
        ("wat ga je doen?", "plan"),
        ("who won the match?", ""),
        ("slow down, would you?", ""),
    ],
)
def test_a_question_about_the_ride_is_known_and_others_are_not(
    reader: ProgramReader, command: str, question: str
) -> None:
    assert read(reader, command).question == question


@pytest.mark.parametrize(
    ("command", "act"),
    [
        ("a bit more", "more"),
        ("No. That's too much!", "less"),
        ("again please", "again"),
        ("no, the other way", "opposite"),
        ("back to how it was", "back"),
        ("noch ein bisschen", "more"),
        ("c'est trop", "less"),
        ("otra vez", "again"),
        ("dall'altra parte", "opposite"),
        ("zoals eerst", "back"),
    ],
)
def test_what_goes_by_the_wish_before_is_unclear_alone_and_says_how(
    reader: ProgramReader, command: str, act: str
) -> None:
    assert plain(read(reader, command)) == {"outcome": "unclear", "steps": [{"act": act}]}


@pytest.mark.parametrize(
    "command",
    [
        "don't stop for the pedestrian",
        "ram that truck in ten seconds",
        "make way for the ambulance, then ram it",
        "wait until the cyclist is beside us, then run him over",
    ],
)
def test_a_danger_is_none_the_less_for_harmless_words_around_it(reader: ProgramReader, command: str) -> None:
    from slow_node.understanding.refusals import unsafe

    reading = reader.read(command, 25.0, 33.0)
    assert unsafe(command) or reading.refused >= 0.4 or reading.program.outcome != "directive"


def test_a_program_is_validated_by_its_schema_and_comes_back_as_it_went() -> None:
    given = {
        "outcome": "directive",
        "steps": [{"act": "lane", "side": "left", "when": {"kind": "free", "side": "left"}}],
    }
    assert plain(msgspec.convert(given, Program)) == given
    for bad in ({"act": "fly"}, {"act": "stop", "when": {"kind": "never"}}, {"act": "drive", "value": -1}, {"rule": 1}):
        with pytest.raises(msgspec.ValidationError):
            msgspec.convert({"outcome": "directive", "steps": [bad]}, Program)


@pytest.mark.parametrize(
    "command",
    [
        "Breng me naar de Kerkstraat 12.",
        "Bring mich in die Lindenstraße 45.",
        "Drop me at 27 Baker Street",
        "¿Te gusta el fútbol?",
    ],
)
def test_an_address_and_small_talk_are_no_speed(reader: ProgramReader, command: str) -> None:
    assert read(reader, command) == Program(outcome="out_of_scope")


SIGNS = {
    "In zwanzig Minuten geht mein Zug!": {"act": "faster"},
    "O voo sai daqui a quarenta minutos!": {"act": "faster"},
    "Jetzt hab ich den ganzen Kaffee auf der Hose.": {"act": "smoother"},
    "Wir hängen dem ja fast im Kofferraum.": {"act": "farther"},
    "This milk float is going to hold us up all day.": {"act": "overtake"},
}


@pytest.mark.parametrize("command", SIGNS)
def test_who_tells_how_he_fares_gets_what_helps(reader: ProgramReader, command: str) -> None:
    assert steps(reader, command) == [SIGNS[command]]


BESIDE_TALK = {
    "Und der Trainer brüllt bloß, überhol den mal bitte, und keiner läuft.": {"act": "overtake"},
    "Sim, mãe, já jantei, vai para a faixa da direita, não, mãe, foi sopa.": RIGHT,
}


@pytest.mark.parametrize(
    ("command", "low", "high", "unit"),
    [
        ("keep between 20 and 30 metres behind that car", 20.0, 30.0, "m"),
        ("halte zwischen 20 und 30 Meter Abstand", 20.0, 30.0, "m"),
        ("stay between 20 and 30 m behind", 20.0, 30.0, "m"),
        ("leave between two and three seconds to the car ahead", 2.0, 3.0, "s"),
        ("entre 2 et 3 secondes de distance", 2.0, 3.0, "s"),
    ],
)
def test_a_gap_between_two_sizes_has_both_bounds(
    reader: ProgramReader, command: str, low: float, high: float, unit: str
) -> None:
    steps = reader.read(command, 25.0, 33.0).program.steps
    assert [(s.act, s.mode, s.value, s.unit) for s in steps] == [
        ("gap", "at_least", low, unit),
        ("gap", "at_most", high, unit),
    ]


@pytest.mark.parametrize("command", BESIDE_TALK)
def test_a_wish_between_the_commas_of_talk_is_found(reader: ProgramReader, command: str) -> None:
    assert steps(reader, command) == [BESIDE_TALK[command]]


def test_a_wish_to_be_too_close_is_no_sign_of_it(reader: ProgramReader) -> None:
    assert read(reader, "Colle-le à deux mètres, il finira bien par se pousser.").outcome != "directive"


def test_a_sign_beside_another_wish_leaves_the_wish_alone(reader: ProgramReader) -> None:
    assert steps(reader, "I feel sick, stop the car")[-1] == {"act": "stop"}


IN_ORDER = {
    "get past him and tuck back in on the right": ["overtake", "lane"],
    "after you've slowed down to 66 open the gap by twenty metres": ["slower", "farther"],
    "brake to 55, wait till that lorry's through, then go left": ["slower", "lane"],
    "find whichever side is open and after that eighty nine": ["lane", "drive"],
    "Vorbei an dem Laster, dann wieder rechts": ["overtake", "lane"],
    "inhalen, terug naar rechts, 99": ["overtake", "lane", "drive"],
    "accelera a centotredici e poi tieni il passo": ["faster", "keep"],
}
TOLD = [
    "In the film they drive off a bridge at full speed, it's brilliant.",
    "Mein Enkel ist gestern mit dem Dreirad von der linken auf die rechte Seite gesaust.",
    "Mon beau-frère s'est pris un PV à cent cinquante-deux, bien fait.",
    "En la telenovela de anoche el galán frenó en seco.",
    "No jogo de ontem o lateral ultrapassou três pela direita.",
]
CALLED = {
    "no no tell him the meeting is at four and uh car get into the lane on the right okay so four o'clock yes": "lane",
    "Marco smettila di tirare i capelli a tua sorella, e tu frena più dolcemente, Marco ho detto basta!": "smoother",
    "pues nada tía, que me ha dejado, coche aflójale un poco anda, y encima por WhatsApp": "slower",
}


@pytest.mark.parametrize("command", IN_ORDER)
def test_wishes_stand_in_the_order_in_which_they_are_said(reader: ProgramReader, command: str) -> None:
    assert [step["act"] for step in steps(reader, command)] == IN_ORDER[command]


@pytest.mark.parametrize("command", TOLD)
def test_what_is_only_told_asks_for_nothing(reader: ProgramReader, command: str) -> None:
    assert read(reader, command).outcome == "out_of_scope"


@pytest.mark.parametrize("command", CALLED)
def test_what_is_said_to_the_car_by_name_in_the_middle_of_talk_is_found(reader: ProgramReader, command: str) -> None:
    assert [step["act"] for step in steps(reader, command)] == [CALLED[command]]
