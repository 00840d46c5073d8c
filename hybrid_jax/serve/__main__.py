# SPDX-License-Identifier: MIT
"""Answer plans over HTTP: `python -m hybrid_jax.serve --run DIR`."""

from pathlib import Path

from hybrid_jax.errors import HybridJaxError
from hybrid_jax.runtime.terminal import remark, run_main


def main(run: Path, host: str = "127.0.0.1", port: int = 8321, waiting: int = 256) -> int:
    """Load a trained run once, and plan for whoever asks: `plan --server`, curl, other programs.

    Args:
        run: folder of a trained run.
        host: address to listen at. Anyone who can reach it can let this machine plan.
        port: port to listen at.
        waiting: most requests that wait; further ones are refused by name until there is room.
    """
    try:
        import uvicorn

        from hybrid_jax.serve.application import make_application
    except ImportError as error:
        raise HybridJaxError(
            f"the server needs the package {error.name}: pip install 'hybrid_jax[serve]'"
        ) from None
    from hybrid_jax.runs.load_planner import load_planner
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runtime.devices import use_all_cores
    from hybrid_jax.serve.plan_queue import PlanQueue
    from hybrid_jax.web.listening import listen_at

    listening = listen_at(host, port)  # an address that is taken is refused before anything loads
    use_all_cores()
    opened = open_run(run)
    queue = PlanQueue(load_planner(opened), waiting)
    application = make_application(queue, opened, host)
    remark(f"plans in {opened.cell.source.name} are answered at http://{host}:{port}/plan")
    remark("stop with Ctrl-C")
    server = uvicorn.Server(uvicorn.Config(application, log_level="warning", access_log=False))
    server.run(sockets=[listening])
    return 0


if __name__ == "__main__":
    run_main(main)
