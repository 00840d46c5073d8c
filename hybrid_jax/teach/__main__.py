# SPDX-License-Identifier: MIT
"""Record demonstrations in the browser: `python -m hybrid_jax.teach --workcell NAME`."""

from pathlib import Path

from hybrid_jax.errors import HybridJaxError
from hybrid_jax.runtime.terminal import remark, run_main


def main(
    workcell: str = "",
    library: Path = Path("skills"),
    robot: str = "",
    tool: str = "",
    package_path: tuple[Path, ...] = (),
    host: str = "127.0.0.1",
    port: int = 8080,
) -> int:
    """Serve a page on which the arm follows a handle; record, replay, name and save.

    Args:
        workcell: name of a shipped cell, or an MJCF file; the handling cell if not given.
        library: folder that the demonstrations are saved to.
        robot: kind of robot, as the recordings are to say; the cell's name if not given.
        tool: site or link that is the tool, where the model does not tell.
        package_path: folders that hold the ROS packages of a URDF's meshes.
        host: address to listen at. Anyone who can reach it can move the simulated arm.
        port: port to listen at.
    """
    try:
        from hybrid_jax.teach.page import TeachPage
        from hybrid_jax.web.page import serve
    except ImportError as error:
        raise HybridJaxError(
            f"the page needs the package {error.name}: pip install 'hybrid_jax[teach]'"
        ) from None
    from hybrid_jax.workcell.assets import default_workcell
    from hybrid_jax.workcell.load import load_workcell

    cell = load_workcell(workcell or default_workcell(), tool=tool, package_paths=package_path)
    page = TeachPage(cell, library, robot or cell.source.name, host, port)
    serve(page)
    remark(f"\ndemonstrations are in {library}")
    return 0


if __name__ == "__main__":
    run_main(main)
