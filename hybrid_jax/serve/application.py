# SPDX-License-Identifier: MIT
"""The server's addresses: `/plan`, `/health` and `/metrics`; see `docs/tuning.md`."""

import asyncio
import contextlib
import json
import traceback
from pathlib import Path

import numpy as np
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route

from hybrid_jax import __version__
from hybrid_jax.errors import HybridJaxError, TaskError, UnknownNameError
from hybrid_jax.export.files import plan_summary, plan_text, refuse_ending
from hybrid_jax.export.trajectories import to_joint_trajectory
from hybrid_jax.runs.run_folder import Run
from hybrid_jax.serve.plan_queue import MOST_TOGETHER, PlanQueue, QueueClosed, QueueFull
from hybrid_jax.tasks.registry import random_task, task_of
from hybrid_jax.tasks.task import Task
from hybrid_jax.web.origins import is_local, is_own

LARGEST = 2**20
"""Largest request [bytes]."""
CODES = {TaskError: 400, UnknownNameError: 400, QueueFull: 503, QueueClosed: 503}
"""Status code of HTTP by the class of an error."""


class OwnOriginOnly:
    """Refuse what pages of other servers send: any page in a browser could ask otherwise."""

    def __init__(self, app, local: bool):
        self._app, self._local = app, local

    async def __call__(self, scope, receive, send) -> None:
        if scope["type"] == "http":
            headers = Headers(scope=scope)
            if not is_own(headers.get("origin"), headers.get("host"), self._local):
                refusal = _error(403, "FOREIGN_ORIGIN", "pages of other servers are not answered")
                return await refusal(scope, receive, send)
        await self._app(scope, receive, send)


def _error(code: int, name: str, sentence: str) -> JSONResponse:
    return JSONResponse({"error": name, "detail": sentence}, code)


def make_application(queue: PlanQueue, run: Run, host: str) -> Starlette:
    """The application of one run.

    Args:
        queue: plans the requests.
        run: that the planner was loaded from.
        host: address that the server listens at.
    """
    service = _Service(queue, run)
    return Starlette(
        routes=[
            Route("/plan", service.plan, methods=["POST"]),
            Route("/health", service.health),
            Route("/metrics", service.metrics),
        ],
        middleware=[Middleware(OwnOriginOnly, local=is_local(host))],
        exception_handlers={
            HybridJaxError: _refused,
            HTTPException: _not_there,
            Exception: _defect,
        },
        lifespan=service.lifespan,
    )


async def _refused(request: Request, error: Exception) -> Response:
    name = type(error).__name__
    return _error(CODES.get(type(error), 400), name, str(error))


async def _not_there(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    there = "POST /plan, GET /health, GET /metrics"
    return _error(error.status_code, "NOT_FOUND", f"{error.detail}: there are {there}")


async def _defect(request: Request, error: Exception) -> Response:
    traceback.print_exception(error)
    return _error(500, "DEFECT", "this is a defect of hybrid_jax; the server's terminal says more")


class _Service:
    """What the addresses answer."""

    def __init__(self, queue: PlanQueue, run: Run):
        self._queue, self._run = queue, run

    @contextlib.asynccontextmanager
    async def lifespan(self, app: Starlette):
        """Context in which the queue is worked off, after plans that load what it takes."""
        tasks = [random_task(self._run.cell, seed) for seed in range(MOST_TOGETHER)]
        worker = asyncio.create_task(self._queue.run(tasks))
        yield
        worker.cancel()
        await asyncio.gather(worker, return_exceptions=True)

    async def plan(self, request: Request) -> Response:
        """A trajectory as files have it; with `?file=NAME.csv` the text of such a file."""
        file = Path(request.query_params.get("file", "plan.json"))
        refuse_ending(file)
        task, seed = self._read(await _body(request))
        result = await self._queue.plan(task, seed)
        cell = self._run.cell
        if "file" not in request.query_params:
            return JSONResponse(to_joint_trajectory(cell, task, result))
        text = plan_text(file, cell, task, result)
        return JSONResponse(plan_summary(result) | {"text": text})

    def _read(self, values) -> tuple[Task, int]:
        """Task and seed of a request: a task file's fields, and `seed`."""
        seed = values.pop("seed", 0) if isinstance(values, dict) else 0
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**32:
            raise TaskError(f"the request: seed must be a whole number from 0 on, got {seed!r}")
        return task_of(self._run.cell, values, "the request"), seed

    async def health(self, request: Request) -> Response:
        """Is the server ready, and for what?"""
        return JSONResponse(
            {
                "status": "ready" if self._queue.is_ready else "warming up",
                "cell": self._run.cell.source.name,
                "run": str(self._run.folder),
                "version": __version__,
            }
        )

    async def metrics(self, request: Request) -> Response:
        """Counts and waiting times, in the text format of Prometheus."""
        counts, seconds = self._queue.counts, np.array(self._queue.counts.seconds)
        lines = [
            f'hybrid_jax_requests_total{{outcome="{name}"}} {getattr(counts, name)}'
            for name in ("planned", "refused", "failed")
        ]
        lines += [f"hybrid_jax_batches_total {counts.batches}"]
        lines += [f"hybrid_jax_requests_waiting {self._queue.waiting}"]
        lines += [
            f'hybrid_jax_request_seconds{{quantile="{q}"}} {np.quantile(seconds, q):.4f}'
            for q in (0.5, 0.9, 0.99)
            if seconds.size
        ]
        return PlainTextResponse("\n".join(lines) + "\n")


async def _body(request: Request):
    """The JSON of a request.

    Raises:
        TaskError: it is too large, or no JSON.
    """
    content = b""
    async for part in request.stream():
        content += part
        if len(content) > LARGEST:
            raise TaskError(f"the request is larger than {LARGEST} bytes")
    try:
        return json.loads(content)
    except (ValueError, RecursionError) as error:
        raise TaskError(f"the request is no JSON: {error}") from None
