# SPDX-License-Identifier: MIT
"""Look at a run in the browser: `python -m hybrid_jax.view --run DIR`."""

from pathlib import Path

from hybrid_jax.errors import HybridJaxError
from hybrid_jax.runtime.terminal import run_main


def main(
    run: Path,
    host: str = "127.0.0.1",
    port: int = 8080,
    meshes: Path | None = None,
) -> int:
    """Serve a page with the run's cell, map, skills and curves; build tasks, plan, play them back.

    Args:
        run: folder of a run; stages that are not finished are left out.
        host: address to listen at. Anyone who can reach it can let this machine plan.
        port: port to listen at.
        meshes: MJCF of the same arm with meshes (MuJoCo Menagerie has many), for the picture.
    """
    try:
        from hybrid_jax.view.page import ViewPage
        from hybrid_jax.web.page import serve
    except ImportError as error:
        raise HybridJaxError(
            f"the page needs the package {error.name}: pip install 'hybrid_jax[view]'"
        ) from None
    from hybrid_jax.runs.run_folder import open_run
    from hybrid_jax.runtime.devices import use_all_cores

    use_all_cores()
    page = ViewPage(open_run(run), host, port, meshes)
    serve(page)
    return 0


if __name__ == "__main__":
    run_main(main)
