"""The language model as the only driver: what it is told, how its answer is read, and when it takes effect."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from deploy.lab.agents import drive
from deploy.lab.language_driver import Said, drive_dilu, lessons, running_model
from schemas.runtime.clock import ManualClock
from schemas.runtime.process import ConfigError
from schemas.wire.messages import Lane, MetaAction, Observation
from sim_node.scenarios import SCENARIOS
from slow_node.baselines.dilu import Bank, Experience, build_prompt, describe, explain, parse
from slow_node.llm.dialect import Chat
from slow_node.llm.embedding import HashedEmbedder
from slow_node.llm.errors import ModelTimeoutError
from tests.scenes import HIGHWAY, TWO_WAY, car, lane, observation

ROAD = HIGHWAY[:3]
RAMP = (lane(0, end_m=800.0), lane(1, end_m=350.0, ramp=True, opens_m=230.0))
BANK = Bank(
    HashedEmbedder(),
    [
        Experience("Your lane: clear.", "No car is near.", MetaAction.SPEED_UP),
        Experience("Your lane: 20 ahead, 4 slower.", "The car ahead is slower.", MetaAction.SLOW_DOWN),
    ],
)


def scene(
    lanes: tuple[Lane, ...], *cars: tuple[float, int, float], target_mps: float | None = None, previous: int = -1
) -> Observation:
    """Cars as (x, lane, speed), the ego first."""
    return observation(
        *(car(k, *where) for k, where in enumerate(cars)),
        lanes=lanes,
        previous_lane=previous,
        **({} if target_mps is None else {"target_speed_mps": target_mps}),
    )


def test_the_description_names_the_cars_around_with_gaps_and_relative_speeds() -> None:
    seen = scene(ROAD, (100, 1, 25), (130, 1, 21), (110, 0, 25.2), (80, 0, 28), (103, 2, 24), target_mps=27)
    assert describe(seen) == (
        "3 lanes, you are in lane 1, 25 of 28 m/s, speeding up. Your lane: 25 ahead, 4 slower. "
        "Left: 5 ahead, same speed; 15 behind, 3 faster. Right: beside, 1 slower."
    )


def test_the_description_leaves_out_cars_that_are_far_away() -> None:
    assert describe(scene(ROAD, (100, 0, 25), (230, 0, 21), (40, 1, 25))) == (
        "3 lanes, you are in lane 0, 25 of 28 m/s. Your lane: clear. Left: none. Right: clear."
    )


def test_the_description_tells_an_oncoming_car_and_a_borrowed_lane() -> None:
    assert "Left: 85 ahead, oncoming." in describe(scene(TWO_WAY, (100, 1, 6), (190, 0, -6)))
    borrowing = describe(scene(TWO_WAY, (100, 0, 6), (107, 1, 4), previous=1))
    assert "Changing to lane 0. This lane is for oncoming cars." in borrowing


def test_the_description_tells_where_the_ramp_ends_and_that_it_cannot_be_left_yet() -> None:
    assert "Lane ends in 250. Your lane: clear. Left: not yet." in describe(scene(RAMP, (100, 1, 15)))
    assert "Lane ends in 100. Your lane: clear. Left: clear." in describe(scene(RAMP, (250, 1, 15)))


def test_the_prompt_is_role_then_examples_with_the_nearest_last_then_the_scene() -> None:
    now = "Your lane: 22 ahead, 4 slower."
    chat = build_prompt(now, BANK.nearest(now))
    assert [turn["role"] for turn in chat] == ["system", "user", "assistant", "user", "assistant", "user"]
    assert chat[4]["content"] == "The car ahead is slower.\nResponse to user:#### 0"
    assert chat[5]["content"] == now


@pytest.mark.parametrize(("answer", "action"), [
    ("The car ahead is slower.\nResponse to user:#### 3", MetaAction.LEFT),
    ("Response to user:####0", MetaAction.SLOW_DOWN),
    ("Response to user:#### 1, no: Response to user:#### 2", MetaAction.SPEED_UP),
    ("Response to user:#### 5", None),
    ("Response to user:#### 12", None),
    ("I would change left.", None),
    ("", None),
])  # fmt: skip
def test_the_answer_is_the_last_action_id_behind_the_mark(answer: str, action: MetaAction | None) -> None:
    assert parse(answer) == action


def test_an_experience_answers_with_its_own_action() -> None:
    seen = scene(ROAD, (100, 1, 25), (130, 1, 21))
    for action in tuple(MetaAction)[:5]:
        assert parse(Experience(describe(seen), explain(seen, action), action).answer) == action


def test_an_empty_memory_is_refused() -> None:
    with pytest.raises(ValueError, match="no experience"):
        Bank(HashedEmbedder(), [])


def test_the_memory_is_the_same_every_time_and_shows_every_action() -> None:
    first, second = lessons(("merge",), range(4)), lessons(("merge",), range(4))
    assert first == second
    assert {e.action for e in first} >= {MetaAction.SLOW_DOWN, MetaAction.CRUISE, MetaAction.SPEED_UP, MetaAction.LEFT}


class Scripted:
    """Always gives the same answer, and takes its time."""

    def __init__(self, answer: str, takes_s: float) -> None:
        self.answer, self.takes_s = answer, takes_s
        self.clock, self.scenes = ManualClock(), list[str]()

    def __call__(self, chat: Chat) -> Said:
        self.scenes.append(chat[-1]["content"])
        self.clock.advance(self.takes_s)
        return Said(self.answer, prompt_tokens=100, answer_tokens=10)


def braking(
    ticks: int, *, paused: bool, takes_s: float = 2.4, answer: str = "Response to user:#### 0"
) -> tuple[float, Scripted, dict[str, object]]:
    """The sum of the ego's accelerations on the highway, who drove, and its metrics."""
    model = Scripted(answer, takes_s)
    scenario = replace(SCENARIOS["highway"], duration_s=ticks / 15)
    results, metrics = drive_dilu(scenario, [1000], paused=paused, ask=model, bank=BANK, clock=model.clock)
    assert results[0].ticks == ticks
    return results[0].accel_sum, model, metrics.summary()


def test_a_paused_world_takes_the_decision_in_the_tick_that_asked() -> None:
    assert braking(1, paused=True)[0] < 0.0


def test_a_running_world_takes_a_decision_of_2_4_s_36_ticks_later() -> None:
    assert braking(36, paused=False)[0] == 0.0
    assert braking(37, paused=False)[0] < 0.0


def test_a_paused_world_is_asked_about_every_second_and_a_running_one_when_the_answer_is_there() -> None:
    assert len(braking(75, paused=True)[1].scenes) == 5
    assert len(braking(75, paused=False)[1].scenes) == 3
    assert len(braking(75, paused=False, takes_s=0.2)[1].scenes) == 5


def test_the_same_script_drives_the_same_episode() -> None:
    first, second = (braking(60, paused=False) for _ in range(2))
    assert first[1].scenes == second[1].scenes
    assert first[0] == second[0]


@pytest.mark.parametrize("name", ["highway", "merge", "two-way"])
def test_a_model_that_always_cruises_drives_and_is_measured_as_the_cruising_agent(name: str) -> None:
    model = Scripted("Response to user:#### 1", 0.1)
    mine, _ = drive_dilu(SCENARIOS[name], [1000, 1001], paused=True, ask=model, bank=BANK, clock=model.clock)
    theirs = drive("cruise", SCENARIOS[name], [1000, 1001])
    mine, theirs = ([replace(r, decisions=0, decisions_with_choice=0) for r in results] for results in (mine, theirs))
    assert repr(mine) == repr(theirs)  # but for how often they decide; repr: nan is nan


def test_an_answer_without_an_action_is_counted_and_cruises() -> None:
    accelerated, _, metrics = braking(30, paused=True, answer="I would rather not say.")
    assert accelerated == 0.0
    assert (metrics["decisions"], metrics["unparseable_share"]) == (2, 1.0)


def test_a_question_without_an_answer_counts_as_one_without_an_action() -> None:
    def never(chat: Chat) -> Said:
        raise ModelTimeoutError("no answer")

    scenario = replace(SCENARIOS["highway"], duration_s=1.0)
    _, metrics = drive_dilu(scenario, [1000], paused=True, ask=never, bank=BANK, clock=ManualClock())
    assert metrics.unparseable == 1


def test_the_figures_are_latencies_and_tokens_per_decision() -> None:
    metrics = braking(45, paused=True)[2]
    assert (metrics["latency_p50_s"], metrics["latency_p95_s"]) == (pytest.approx(2.4), pytest.approx(2.4))
    assert (metrics["prompt_tokens"], metrics["answer_tokens"]) == (100.0, 10.0)


@pytest.fixture
def endpoint(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[dict[str, object]]]:
    """An OpenAI-compatible server named by the environment; what it was sent."""
    bodies: list[dict[str, object]] = []

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            bodies.append(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
            answer = json.dumps(
                {
                    "choices": [{"message": {"content": "Response to user:#### 2"}}],
                    "usage": {"prompt_tokens": 321, "completion_tokens": 12},
                }
            ).encode()
            self.send_response(200)
            self.send_header("Content-Length", str(len(answer)))
            self.end_headers()
            self.wfile.write(answer)

        def log_message(self, *_: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    monkeypatch.setenv("OPENAI_API_KEY", "any")
    monkeypatch.setenv("OPENAI_BASE_URL", f"http://127.0.0.1:{server.server_address[1]}/v1")
    monkeypatch.setenv("OPENAI_MODEL", "some-model")
    yield bodies
    server.shutdown()
    server.server_close()


def test_the_endpoint_of_the_environment_is_asked_for_text(endpoint: list[dict[str, object]]) -> None:
    with running_model() as ask:
        assert ask(build_prompt("Your lane: clear.", [])) == Said("Response to user:#### 2", 321, 12)
    assert endpoint[0]["model"] == "some-model"
    assert "response_format" not in endpoint[0]


def test_an_endpoint_that_is_not_there_ends_the_drive_with_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OPENAI_API_KEY", "any")
    monkeypatch.setenv("OPENAI_BASE_URL", "http://127.0.0.1:9/v1")
    monkeypatch.setenv("OPENAI_MODEL", "some-model")
    with running_model() as ask, pytest.raises(ConfigError, match="cannot be reached"):
        ask(build_prompt("Your lane: clear.", []))
