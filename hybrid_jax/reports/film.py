# SPDX-License-Identifier: MIT
"""Films of simulated runs, drawn off-screen."""

import warnings
from collections.abc import Iterable
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw

from hybrid_jax.runtime.terminal import remark

FPS = 10
"""Frames of a film per simulated second."""
GIF_SPEED, GIF_COLOURS = 6, 64
"""Speed of a GIF as a multiple of real time, and its number of colours."""
SIZE = 360, 480
"""Height and width of a picture [pixel]."""


def make_renderer(model: mujoco.MjModel) -> mujoco.Renderer | None:
    """Off-screen renderer; None, and a remark on the terminal, without EGL and OSMesa."""
    try:
        renderer = mujoco.Renderer(model, *SIZE)
    except Exception as error:
        remark(
            f"no film: off-screen rendering failed ({type(error).__name__}); install EGL (libegl1) "
            "or OSMesa (libosmesa6) and set MUJOCO_GL=egl or MUJOCO_GL=osmesa. Nothing else is "
            "affected."
        )
        return None
    for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
        renderer.scene.flags[flag] = 0  # software renderers spend most of their time on them
    return renderer


def render(model: mujoco.MjModel, frames: np.ndarray, rate: float = 20.0) -> list[np.ndarray]:
    """Pictures of a run, `FPS` per simulated second.

    Args:
        model: the cell; its camera `overview` is used if there is one.
        frames: `[frame, nq]` MuJoCo's `qpos`.
        rate: frames per second.

    Returns:
        Pictures `[height, width, 3]`; none where off-screen rendering does not work.
    """
    renderer = make_renderer(model)
    if renderer is None:
        return []
    cameras = [model.camera(i).name for i in range(model.ncam)]
    camera = "overview" if "overview" in cameras else -1
    data, pictures = mujoco.MjData(model), []
    with renderer:
        for i in np.arange(0, len(frames), rate / FPS).astype(int):
            data.qpos[:] = frames[i]
            mujoco.mj_forward(model, data)
            renderer.update_scene(data, camera=camera)
            pictures.append(renderer.render().copy())
    return pictures


def side_by_side(films: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """Several films as one, side by side under their names; a shorter one rests at its end.

    Args:
        films: pictures `[height, width, 3]` of each, by name; all of one size.

    Returns:
        Pictures `[height, film * width, 3]`.
    """
    length = max(map(len, films.values()))
    columns = [
        [_named(pictures[min(i, len(pictures) - 1)], name) for i in range(length)]
        for name, pictures in films.items()
    ]
    return [np.concatenate(row, axis=1) for row in zip(*columns, strict=True)]


def _named(picture: np.ndarray, name: str) -> np.ndarray:
    image = Image.fromarray(picture)
    outline = {"stroke_width": 2, "stroke_fill": "black"}
    ImageDraw.Draw(image).text((12, 10), name, fill="white", font_size=20, **outline)
    return np.asarray(image)


def save_stills(path: Path, pictures: list[np.ndarray]) -> None:
    """Write six pictures `[height, width, 3]`, evenly spaced over a film, as one file."""
    moments = [pictures[int(i)] for i in np.linspace(0, len(pictures) - 1, 6)]
    rows = [np.concatenate(moments[:3], axis=1), np.concatenate(moments[3:], axis=1)]
    Image.fromarray(np.concatenate(rows)).save(path)


def save_film(path: Path, pictures: Iterable[np.ndarray]) -> bool:
    """Write an MP4, or a GIF, of pictures `[height, width, 3]`; the ending decides.

    Returns:
        False, after a remark on the terminal, where that is not possible.
    """
    if path.suffix.lower() == ".gif":
        return _save_gif(path, list(pictures))
    try:
        import imageio.v2 as imageio

        with warnings.catch_warnings():
            # JAX warns of every fork; this child starts ffmpeg at once
            warnings.simplefilter("ignore", RuntimeWarning)
            imageio.mimwrite(path, list(pictures), fps=FPS, macro_block_size=1)
    except (ImportError, OSError, ValueError) as error:
        remark(f"no {path.name} ({error})")
        return False
    return True


def _save_gif(path: Path, pictures: list[np.ndarray]) -> bool:
    """Write a small GIF: sped up by `GIF_SPEED`, with few colours."""
    images = [Image.fromarray(picture) for picture in pictures[::GIF_SPEED]]
    first, *followers = (image.quantize(GIF_COLOURS, dither=Image.Dither.NONE) for image in images)
    first.save(path, save_all=True, append_images=followers, duration=1000 // FPS, loop=0)
    return True


def save(stem: Path, pictures: list[np.ndarray]) -> None:
    """Write pictures `[height, width, 3]` as `STEM.png` (six of them) and `STEM.mp4`.

    The film needs ffmpeg; nothing is written if there are no pictures.
    """
    if pictures:
        save_stills(stem.with_suffix(".png"), pictures)
        save_film(stem.with_suffix(".mp4"), pictures)
