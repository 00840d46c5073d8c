# SPDX-License-Identifier: MIT
"""Requests for plans that wait for the planner: those that arrive together are one batch."""

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field

import jax

from hybrid_jax.contracts import PlanResult
from hybrid_jax.errors import HybridJaxError
from hybrid_jax.planner.pipeline import plan_batch
from hybrid_jax.planner.records import Planner
from hybrid_jax.tasks.task import Task

MOST_TOGETHER = 16
"""Most requests that are planned as one batch."""
REMEMBERED = 1000
"""Requests whose waiting times count for the quantiles."""


class QueueFull(HybridJaxError):
    """So many requests wait that no further one is taken."""


class QueueClosed(HybridJaxError):
    """The server stops: requests that wait are not planned."""


@dataclass
class Counts:
    """What the queue has done so far."""

    planned: int = 0
    """Requests that were answered with a plan or with why there is none."""
    refused: int = 0
    """Requests that found no room."""
    failed: int = 0
    """Requests that were lost to a defect or to the end of the server."""
    batches: int = 0
    """Calls of the planner."""
    seconds: deque = field(default_factory=lambda: deque(maxlen=REMEMBERED))
    """Time from arrival to answer of the last requests [s]."""


async def _in_thread(function: Callable, *args, **kwargs):
    """The result of a function that runs in a thread which nobody waits for at the end.

    `asyncio.to_thread` would keep a server that was stopped until a program is compiled.
    """
    loop, future = asyncio.get_running_loop(), Future()
    # a server that stops does not wait for it, and must not cancel what the thread will set
    future.set_running_or_notify_cancel()

    def run() -> None:
        try:
            future.set_result(function(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    return await asyncio.wrap_future(future, loop=loop)


class PlanQueue:
    """Plans requests in the order of their arrival, in batches, in one thread beside the server."""

    def __init__(self, planner: Planner, limit: int, plan: Callable = plan_batch):
        """Make an empty queue.

        Args:
            planner: cell, skills and agents.
            limit: most requests that wait.
            plan: as `plan_batch`.
        """
        self.planner, self.counts = planner, Counts()
        self._limit, self._plan = limit, plan
        self._waiting: deque[tuple[Task, int, asyncio.Future]] = deque()
        self._arrived = asyncio.Event()
        self.is_ready = False
        """Have the programs of single requests and of batches been loaded or compiled?"""

    @property
    def waiting(self) -> int:
        """Number of requests that wait."""
        return len(self._waiting)

    async def plan(self, task: Task, seed: int) -> PlanResult:
        """The plan of a task.

        Args:
            task: to be planned.
            seed: of IK and rollouts. Requests of one seed are planned together, so that a plan
                depends on what is planned beside it.

        Raises:
            QueueFull: no room, the task was not taken.
            QueueClosed: the server stops.
        """
        if len(self._waiting) >= self._limit:
            self.counts.refused += 1
            raise QueueFull(f"{self._limit} requests wait already: ask again later")
        began, future = time.monotonic(), asyncio.get_running_loop().create_future()
        self._waiting.append((task, seed, future))
        self._arrived.set()
        result = await future
        self.counts.seconds.append(time.monotonic() - began)
        return result

    def _next_batch(self) -> tuple[list[Task], int, list[asyncio.Future]]:
        """The first request and those behind it with its seed, as many as go together."""
        seed, batch = self._waiting[0][1], []
        while self._waiting and len(batch) < MOST_TOGETHER and self._waiting[0][1] == seed:
            batch.append(self._waiting.popleft())
        # whoever has hung up is not planned for
        asked = [(task, future) for task, _, future in batch if not future.done()]
        return [task for task, _ in asked], seed, [future for _, future in asked]

    async def run(self, first_tasks: Sequence[Task] = ()) -> None:
        """Plan what arrives, until this is cancelled.

        Args:
            first_tasks: are planned before, the first alone and then all: what loads or compiles
                for them does not keep others waiting later.
        """
        try:
            for tasks in filter(None, (first_tasks[:1], first_tasks)):
                await _in_thread(self._plan, self.planner, tasks, key=jax.random.key(0))
            self.is_ready = True
            while True:
                await self._arrived.wait()
                while self._waiting:
                    await self._answer(*self._next_batch())
                self._arrived.clear()
        finally:
            for _, _, future in self._waiting:
                if not future.done():
                    future.set_exception(QueueClosed("the server stops: ask its successor"))
                    self.counts.failed += 1

    async def _answer(self, tasks: list[Task], seed: int, futures: list[asyncio.Future]) -> None:
        if not tasks:
            return
        try:
            results = await _in_thread(self._plan, self.planner, tasks, key=jax.random.key(seed))
        except BaseException as error:
            # a defect costs this batch its plans, not the server its life
            lost = error if isinstance(error, Exception) else QueueClosed("the server stops")
            for future in futures:
                if not future.done():
                    future.set_exception(lost)
            self.counts.failed += len(futures)
            if not isinstance(error, Exception):
                raise
            return
        self.counts.batches += 1
        self.counts.planned += len(futures)
        for future, result in zip(futures, results, strict=True):
            if not future.done():
                future.set_result(result)
