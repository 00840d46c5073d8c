# SPDX-License-Identifier: MIT
"""Options of XLA's compiler for single programs: how fast they are made, and how fast they run."""

import functools
import re
from importlib.metadata import version
from pathlib import Path

import jax

PIECES = 4
"""Pieces that XLA cuts a program in, to compile them in parallel: by default 32. Each piece takes
memory maps, of which Linux allows a process some 65,000."""


@functools.cache
def few_pieces() -> dict[str, int]:
    """Options with which a program takes few memory maps on a CPU."""
    on_cpu = jax.default_backend() == "cpu"
    return {"xla_cpu_parallel_codegen_split_count": PIECES} if on_cpu else {}


@functools.cache
def quick_options() -> dict[str, int | bool]:
    """Options that shorten compiling on a CPU; none for an accelerator.

    XLA's newer code generator for fused operations, which jaxlib below 0.11 can leave out, compiles
    for longer than the old one. The clearance kernel runs markedly slower without it, so programs
    that spend their time in it do without these options.
    """
    release = tuple(int(part) for part in version("jaxlib").split(".")[:2])
    has_choice = jax.default_backend() == "cpu" and release < (0, 11)
    return few_pieces() | ({"xla_cpu_use_fusion_emitters": False} if has_choice else {})


@functools.cache
def vector_options() -> dict[str, int]:
    """Options for element-wise kernels on this machine.

    By default XLA avoids the widest vectors of x86 processors, which lowered the clock of earlier
    ones; the clearance kernel is 13 % faster with them.
    """
    cpuinfo = Path("/proc/cpuinfo")
    has_avx512 = cpuinfo.is_file() and re.search(
        r"^flags.*\bavx512f\b", cpuinfo.read_text(), re.MULTILINE
    )
    on_cpu = jax.default_backend() == "cpu"
    return {"xla_cpu_prefer_vector_width": 512} if has_avx512 and on_cpu else {}
