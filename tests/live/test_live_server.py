"""The server of the live page: whom it answers, what it says of specs, and how it plans."""

from __future__ import annotations

import http.client
import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from climbplan.errors import UsageError
from climbplan.live.planning import Planner
from climbplan.live.server import MAX_BODY, LiveServer
from climbplan.schema.examples import read_example

SMALL = read_example("bookshelf_scene")


@contextmanager
def serving(folder: Path) -> Iterator[LiveServer]:
    """The live page of a folder, on a free port."""
    with LiveServer(folder, 0) as live:
        thread = threading.Thread(target=live.run)
        thread.start()
        try:
            yield live
        finally:
            live.stop()
            thread.join()


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveServer]:
    with serving(tmp_path_factory.mktemp("live")) as server:
        yield server


def send(
    live: LiveServer,
    path: str,
    fields: Any = None,
    *,
    token: str | None = None,
    body: bytes | None = None,
    **headers: str,
) -> tuple[int, Any]:
    """Status and answer of a request; a GET without fields and body. Names of headers have _."""
    connection = http.client.HTTPConnection("127.0.0.1", live.port, timeout=60)
    own = {"Content-Type": "application/json"} if fields is not None else {}
    sent = {**own, **{name.replace("_", "-"): value for name, value in headers.items()}}
    content = json.dumps(fields).encode() if fields is not None else body
    method = "GET" if content is None else "POST"
    try:
        path = f"/{live.token if token is None else token}/{path}"
        connection.request(method, path, content, sent)
        answer = connection.getresponse()
        text = answer.read().decode()
        is_json = answer.headers.get_content_type() == "application/json"
        return answer.status, json.loads(text) if is_json else text
    finally:
        connection.close()


def plan_and_wait(live: LiveServer, text: str) -> dict[str, Any]:
    """The last event of a plan."""
    status, answer = send(live, "plan", {"text": text, "quick": True})
    assert status == 200, answer
    status, events = send(live, f"events/{answer['run']['number']}")
    assert status == 200
    last: dict[str, Any] = json.loads(events.strip().rpartition("data: ")[2])
    return last


def test_the_page_is_whole_and_its_policy_lets_nothing_else_in(live: LiveServer) -> None:
    status, page = send(live, "")
    assert status == 200
    assert 'id="spec"' in page
    assert "default-src &#39;none&#39;" in page or "default-src 'none'" in page
    assert "https://" not in page  # it works offline
    assert "http://" not in page


@pytest.mark.parametrize(
    "change",
    [
        {"token": ""},
        {"token": "wrong"},
        {"Host": "evil.example"},
        {"Host": "127.0.0.1:1"},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Origin": "http://127.0.0.1:1"},
    ],
)
def test_strangers_are_refused(live: LiveServer, change: dict[str, str]) -> None:
    for path, fields in (("all", None), ("validate", {"text": SMALL}), ("plan", {"text": SMALL})):
        status, answer = send(live, path, fields, **change)  # type: ignore[arg-type]
        assert status == 403
        assert set(answer) == {"error"}
    assert live.planner.list_runs() == []


def test_the_page_itself_is_answered_under_both_names(live: LiveServer) -> None:
    for name in ("127.0.0.1", "localhost"):
        own = f"{name}:{live.port}"
        assert send(live, "validate", {"text": SMALL}, Host=own, Origin=f"http://{own}")[0] == 200


def test_it_listens_on_this_machine_alone(live: LiveServer) -> None:
    assert live._server.server_address[0] == "127.0.0.1"
    assert live.address.startswith("http://127.0.0.1:")
    assert len(live.token) >= 32


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"Content_Length": str(MAX_BODY + 1)}, 413),
        ({"Content_Length": "-1"}, 411),
        ({"Content_Type": "text/plain"}, 415),  # which pages of others may send without asking
        ({}, 400),
    ],
)
def test_bad_bodies_are_refused(live: LiveServer, headers: dict[str, str], status: int) -> None:
    sent = {"Content_Type": "application/json", **headers}
    code, answer = send(live, "validate", body=b"[]", **sent)  # type: ignore[arg-type]
    assert code == status
    assert answer["error"]


def test_mistakes_have_lines_and_keys(live: LiveServer) -> None:
    status, answer = send(live, "validate", {"text": SMALL})
    assert (status, answer["valid"], answer["kind"]) == (200, True, "bookshelf")
    wrong = SMALL.replace("insert:", "insrt:")
    answer = send(live, "validate", {"text": wrong})[1]
    line = wrong.splitlines().index(next(t for t in wrong.splitlines() if "insrt:" in t)) + 1
    (unknown,) = (m for m in answer["mistakes"] if m["key"] == "scene.insrt")
    assert (unknown["line"], unknown["suggestion"]) == (line, "insert")
    for text in ("", "kind: [", "kind: climb\nrobot: nowhere.yaml\n"):
        answer = send(live, "validate", {"text": text})[1]
        assert not answer["valid"]
        assert answer["mistakes"]
    # What is wrong with the scene, which only building it finds
    climb = read_example("climb_tube").replace("radius: 0.", "radius: 900.")
    (mistake,) = send(live, "validate", {"text": climb})[1]["mistakes"]
    assert mistake["key"] == "terrain.tube.radius"
    assert mistake["line"]


def test_schemas_and_specs_are_served(live: LiveServer) -> None:
    assert send(live, "schema/climb")[1]["$id"] == "urn:climbplan:spec:climb"
    assert send(live, "schema/nothing")[0] == 422
    listed = send(live, "all")[1]
    assert "climb_tube" in listed["examples"]
    assert "climb_rough_chimney" not in listed["examples"]  # which reads a scan
    assert send(live, "spec/example/climb_tube")[1]["text"] == read_example("climb_tube")
    assert send(live, "nowhere")[0] == 404
    assert send(live, "outcome/99")[0] == 404
    assert send(live, "events/99")[0] == 404


def test_specs_are_saved_in_the_folder_alone(live: LiveServer) -> None:
    assert send(live, "save", {"name": "own.yaml", "text": SMALL})[0] == 200
    assert (live.folder / "own.yaml").read_text() == SMALL
    assert send(live, "spec/file/own.yaml")[1]["text"] == SMALL
    assert "own.yaml" in send(live, "all")[1]["files"]
    assert send(live, "save", {"name": "own.yaml", "text": "x"})[0] == 422
    assert send(live, "save", {"name": "own.yaml", "text": "x", "replace": True})[0] == 200
    outside = live.folder.parent / "outside.yaml"
    (live.folder / "link.yaml").symlink_to(outside)
    for name in ("../outside.yaml", "/outside.yaml", "link.yaml", "x.txt", ".x.yaml", "a/b.yaml"):
        status, answer = send(live, "save", {"name": name, "text": "x", "replace": True})
        assert status == 422, (name, answer)
        assert send(live, f"spec/file/{name}")[0] in (404, 422)
    assert not outside.exists()
    outputs = live.folder.parent / "linked"
    outputs.mkdir()
    (outputs / "outputs").symlink_to(live.folder)
    with pytest.raises(UsageError, match="leads out"):
        Planner(outputs).start("bookshelf", SMALL, True)


def test_a_plan_is_made_checked_replayed_and_compared(live: LiveServer) -> None:
    last = plan_and_wait(live, SMALL)
    assert last["complete"]
    assert last["outcome"] in ("fine", "look")
    first = last["number"]
    assert (live.folder / f"outputs/live_{first}/plan.h5").is_file()
    outcome = send(live, f"outcome/{first}")[1]
    assert "contact.sides" in outcome or "<th>" in outcome
    assert "Verification" in outcome
    assert 'id="replay-data"' in send(live, f"replay/{first}")[1]
    second = plan_and_wait(live, SMALL.replace("seed: 0", "seed: 1") + "# another\n")["number"]
    comparison = send(live, f"comparison/{first}/{second}")[1]
    assert "# another" in comparison
    assert 'class="added"' in comparison
    runs = send(live, "all")[1]["runs"]
    assert [run["number"] for run in runs][-2:] == [first, second]


def test_specs_with_mistakes_and_of_other_kinds_are_not_planned(live: LiveServer) -> None:
    before = len(live.planner.list_runs())
    answer = send(live, "plan", {"text": SMALL.replace("insert:", "insrt:")})[1]
    assert not answer["valid"]
    status, answer = send(live, "plan", {"text": read_example("silvia")})
    assert status == 422
    assert "robot" in answer["error"]
    assert len(live.planner.list_runs()) == before


@pytest.fixture
def wait_for_line() -> Callable[[LiveServer, int], None]:
    def wait(live: LiveServer, number: int) -> None:
        run = live.planner.find_run(number)
        assert run is not None
        for _ in live.planner.follow(run, 1.0):
            if run.progress_text:
                return

    return wait


def test_one_plan_at_a_time_and_it_can_be_cancelled(
    tmp_path: Path, wait_for_line: Callable[[LiveServer, int], None]
) -> None:
    long = read_example("climb_region")  # a study of many climbs
    with serving(tmp_path) as live:
        number = send(live, "plan", {"text": long})[1]["run"]["number"]
        status, answer = send(live, "plan", {"text": SMALL})
        assert status == 409
        assert "cancel" in answer["error"]
        wait_for_line(live, number)
        assert send(live, "cancel", {})[1] == {"cancelled": True}
        last = json.loads(send(live, f"events/{number}")[1].strip().rpartition("data: ")[2])
        assert (last["complete"], last["outcome"]) == (True, "cancelled")
        assert "cancelled" in send(live, f"outcome/{number}")[1]
        assert list((tmp_path / "outputs").glob("*")) == []
        assert send(live, "cancel", {})[1] == {"cancelled": False}


def test_leaving_ends_the_planning_process(
    tmp_path: Path, wait_for_line: Callable[[LiveServer, int], None]
) -> None:
    with serving(tmp_path) as live:
        number = send(live, "plan", {"text": read_example("climb_region")})[1]["run"]["number"]
        wait_for_line(live, number)
        child = live.planner._child
        assert child is not None
    assert child.poll() is not None
