# SPDX-License-Identifier: MIT
"""Plans over HTTP: batches, limits and refusals by name, and a client that says what is wrong."""

import asyncio
import json
import socket
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from types import SimpleNamespace

import pytest

from hybrid_jax import plan
from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import InputError, TaskError
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.serve.client import ServerError, ask_for_plan
from hybrid_jax.serve.plan_queue import MOST_TOGETHER, PlanQueue, QueueClosed, QueueFull
from hybrid_jax.types import Status
from hybrid_jax.web.listening import listen_at

RESULT = PlanResult(Status.NO_PATH, "none of them")


def queue_of(plan, limit=100):
    return PlanQueue(SimpleNamespace(cell=None), limit, plan)


async def worked_off(queue, requests):
    """Results of requests (task, seed) that all arrive before the queue is worked off."""
    asked = [asyncio.create_task(queue.plan(task, seed)) for task, seed in requests]
    await asyncio.sleep(0)
    worker = asyncio.create_task(queue.run())
    results = await asyncio.gather(*asked, return_exceptions=True)
    worker.cancel()
    return results


def test_requests_that_wait_together_are_batches_of_one_seed():
    batches = []

    def plan(planner, tasks, *, key):
        batches.append(list(tasks))
        return [PlanResult(Status.NO_PATH, f"task {task}") for task in tasks]

    requests = [(i, 0) for i in range(MOST_TOGETHER + 2)] + [(98, 1), (99, 0)]
    results = asyncio.run(worked_off(queue_of(plan), requests))
    assert [result.detail for result in results] == [f"task {task}" for task, _ in requests]
    assert batches == [[*range(16)], [16, 17], [98], [99]]


def test_a_full_queue_refuses_by_name_and_the_others_are_answered():
    queue = queue_of(lambda planner, tasks, key: [RESULT] * len(tasks), limit=3)
    results = asyncio.run(worked_off(queue, [(i, 0) for i in range(5)]))
    assert results[:3] == [RESULT] * 3
    assert all(isinstance(error, QueueFull) for error in results[3:])
    assert (queue.counts.planned, queue.counts.refused) == (3, 2)


def test_a_defect_costs_one_batch_only():
    def plan(planner, tasks, *, key):
        if "bad" in tasks:
            raise ZeroDivisionError
        return [RESULT] * len(tasks)

    results = asyncio.run(worked_off(queue_of(plan), [("bad", 0), ("good", 1)]))
    assert isinstance(results[0], ZeroDivisionError) and results[1] is RESULT


def test_a_plan_that_outlives_the_server_ends_in_silence(monkeypatch):
    begun, may_end, raised = threading.Event(), threading.Event(), []
    monkeypatch.setattr(threading, "excepthook", raised.append)
    before = set(threading.enumerate())

    def plan(planner, tasks, *, key):
        begun.set()
        may_end.wait(10)
        return tasks

    async def stopped() -> set[threading.Thread]:
        queue = queue_of(plan)
        asked = asyncio.create_task(queue.plan("task", 0))
        await asyncio.sleep(0)
        worker = asyncio.create_task(queue.run())
        while not begun.is_set():
            await asyncio.sleep(0.01)
        worker.cancel()
        await asyncio.gather(asked, worker, return_exceptions=True)
        return {t for t in threading.enumerate() if t.daemon} - before

    outliving = asyncio.run(stopped())
    may_end.set()
    for thread in outliving:
        thread.join()
    assert outliving and not raised


def test_who_waits_when_the_server_stops_is_told_so():
    async def stopped():
        queue = queue_of(lambda planner, tasks, key: time.sleep(0.2) or [RESULT] * len(tasks))
        asked = [asyncio.create_task(queue.plan(i, i)) for i in range(3)]
        worker = asyncio.create_task(queue.run())
        await asyncio.sleep(0.05)
        worker.cancel()
        return await asyncio.gather(*asked, return_exceptions=True)

    assert all(isinstance(error, QueueClosed) for error in asyncio.run(stopped()))


def test_first_plans_are_made_before_what_waits_and_do_not_count():
    """Also where fewer requests may wait than are planned then."""
    batches = []

    def plan(planner, tasks, *, key):
        batches.append(list(tasks))
        return [RESULT] * len(tasks)

    async def served():
        queue = queue_of(plan, limit=2)
        worker = asyncio.create_task(queue.run(["a", "b", "c"]))
        assert not queue.is_ready and await queue.plan("d", 0) is RESULT and queue.is_ready
        worker.cancel()
        return queue.counts.planned

    assert asyncio.run(served()) == 1 and batches == [["a"], ["a", "b", "c"], ["d"]]


def test_asking_a_server_imports_no_jax():
    code = "import sys, hybrid_jax.plan, hybrid_jax.serve.client, hybrid_jax.runtime.output_files"
    code += "; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as probe:
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def server(planner):
    """Address of a server of the handling cell, in a thread."""
    import uvicorn

    from hybrid_jax.serve.application import make_application

    port = free_port()
    run = SimpleNamespace(cell=planner.cell, folder="runs/none")
    application = make_application(PlanQueue(planner, 4, plan_batch), run, "127.0.0.1")
    server = uvicorn.Server(uvicorn.Config(application, log_level="warning"))
    listening = listen_at("127.0.0.1", port)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{port}"
    server.should_exit = True
    thread.join(60)


def reply(address, content=None, **headers):
    """Status code and content of an answer."""
    try:
        with urllib.request.urlopen(urllib.request.Request(address, content, headers)) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def test_a_plan_comes_as_files_have_it(server, tmp_path):
    task = tmp_path / "task.json"
    task.write_text('{"object": "block_1", "scene_seed": 3}')
    for name in ("plan.json", "plan.csv"):
        assert plan.main(task=task, out=tmp_path / name, server=server, quiet=True) == 0
    written = json.loads((tmp_path / "plan.json").read_text())
    code, answered = reply(f"{server}/plan", task.read_bytes())
    assert code == 200 and json.loads(answered) == written and written["status"] == "OK"
    assert len((tmp_path / "plan.csv").read_text().splitlines()) == len(written["points"]) + 1


@pytest.mark.parametrize(
    "content, code, sentence",
    [
        (b"{", 400, "no JSON"),
        (b'{"object": "spoon"}', 400, "unknown object 'spoon'"),
        (b'{"object": "block_1", "colour": 1}', 400, "unknown field 'colour'"),
        (b'{"object": "block_1", "seed": -1}', 400, "seed must be a whole number"),
        (b" " * 2**21, 400, "larger than 1048576 bytes"),
    ],
)
def test_a_bad_request_is_one_sentence(server, content, code, sentence):
    answered = reply(f"{server}/plan", content)
    assert answered[0] == code and sentence in answered[1]


def test_other_addresses_and_foreign_pages_are_refused(server):
    assert reply(f"{server}/plans")[0] == 404
    assert reply(f"{server}/plan")[0] == 405
    assert reply(f"{server}/plan?file=plan.xml", b"{}")[0] == 400
    for headers in ({"Origin": "http://elsewhere.example"}, {"Host": "elsewhere.example"}):
        code, content = reply(f"{server}/health", **headers)
        assert code == 403 and "FOREIGN_ORIGIN" in content


def test_health_and_metrics(server):
    assert json.loads(reply(f"{server}/health")[1])["cell"] == "gen3_handling"
    assert 'hybrid_jax_requests_total{outcome="planned"}' in reply(f"{server}/metrics")[1]


def test_a_client_says_what_is_wrong(tmp_path):
    task = tmp_path / "task.json"
    task.write_text('{"object": "block_1"}')
    with pytest.raises(InputError, match="--server must be like"):
        ask_for_plan("127.0.0.1:1", task, "plan.json", 0)
    with pytest.raises(ServerError, match="no server answers at .*hybrid_jax.serve"):
        ask_for_plan("http://127.0.0.1:1", task, "plan.json", 0)
    task.write_text("[]")
    with pytest.raises(TaskError, match="must hold an object of JSON"):
        ask_for_plan("http://127.0.0.1:1", task, "plan.json", 0)
    with pytest.raises(InputError, match="either the folder of a run"):
        plan.main(task=task, out=tmp_path / "plan.json")


def test_an_address_that_is_taken_is_named():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match=f"port {port} .*name a port that is free"):
            listen_at("127.0.0.1", port)
    with pytest.raises(InputError, match="from 1 to 65535, got 0"):
        listen_at("127.0.0.1", 0)
