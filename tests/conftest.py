# SPDX-License-Identifier: MIT
"""Shared fixtures, and how the tests are compiled and spread over workers."""

import os
import shutil
import tempfile
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import pytest
from packaging.version import Version

# The suite's time is that of compiling: quick code instead of fast code takes a third of it.
# With XLA_FLAGS set, also to nothing, the tests run what users run.
QUICK = ["--xla_backend_optimization_level=0"]
if Version(version("jaxlib")) < Version("0.11"):
    QUICK.append("--xla_cpu_use_fusion_emitters=false")  # a process ends at a flag XLA lacks
os.environ.setdefault("XLA_FLAGS", " ".join(QUICK))
# The same programs recur in many tests.
os.environ.setdefault(
    "JAX_COMPILATION_CACHE_DIR", str(Path(tempfile.gettempdir()) / "hybrid_jax_test_cache")
)

from hybrid_jax.runtime.compile_cache import enable_compile_cache  # noqa: E402
from hybrid_jax.runtime.terminal import collect_garbage_rarely  # noqa: E402

enable_compile_cache()
collect_garbage_rarely()

import numpy as np  # noqa: E402

from hybrid_jax.workcell.load import load_workcell  # noqa: E402

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A module's tests share a worker, and so do all that read the smoke run: it is made once.

    Benchmarks run in processes of their own: each goes to whoever is free.
    """
    from xdist.scheduler import LoadScopeScheduling

    class ByModule(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            if "each_benchmark" in nodeid:
                return nodeid
            module = nodeid.split("::")[0]
            reads_run = "smoke_run" in (config.rootpath / module).read_text()
            return "smoke run" if reads_run else module

    return ByModule(config, log)


@pytest.fixture(autouse=True, scope="module")
def few_programs():
    """Drop a module's programs: all of them together need more memory maps than a process may have.

    XLA crashes where Linux refuses one more (`vm.max_map_count`).
    """
    yield
    from hybrid_jax.runtime.kept_programs import forget_programs

    forget_programs()


@pytest.fixture
def strict_promotion():
    """Kernels do not mix arrays of different ranks or types without saying so."""
    import jax

    with jax.numpy_rank_promotion("raise"), jax.numpy_dtype_promotion("strict"):
        yield


@pytest.fixture(scope="session")
def cell():
    """The handling cell."""
    return load_workcell("gen3_handling")


@pytest.fixture(scope="session")
def small_cell(tmp_path_factory):
    """An arm of seven joints without a gripper, a floor and a wall: what compiles quickly."""
    import arms

    return load_workcell(arms.small_cell(tmp_path_factory.mktemp("cell") / "small.xml"))


@pytest.fixture(scope="session")
def planner(cell):
    """The handling cell's planner with exact stand-ins: RRT-Connect in the joint agent's place."""
    from hybrid_jax.planner.bridging import rrt_bridger
    from hybrid_jax.planner.rrt_connect import RrtConfig
    from hybrid_jax.runs.load_planner import untrained_planner

    return replace(untrained_planner(cell, 0.1), bridge=rrt_bridger(cell, RrtConfig()))


@pytest.fixture(scope="session")
def planned(planner):
    """A task and its plan."""
    import jax

    from hybrid_jax.planner.pipeline import plan_motion
    from hybrid_jax.tasks.registry import random_task

    task = random_task(planner.cell, 4)
    return task, plan_motion(planner, task, key=jax.random.key(0))


@pytest.fixture(scope="session")
def configurations(cell):
    """200 random configurations within the limits, float32."""
    low, high = np.asarray(cell.joint_limits).T
    return np.random.default_rng(0).uniform(low, high, (200, len(low))).astype(np.float32)


@pytest.fixture(scope="session")
def shared():
    """Reference data beside the checkout; a test that needs it skips without it."""
    if not SHARED.is_dir():
        pytest.skip("reference data beside the checkout is absent")
    return SHARED


@pytest.fixture(scope="session")
def smoke_run(tmp_path_factory):
    """Folder of a complete run of the smoke preset; tests that change it take a copy."""
    from hybrid_jax import train

    folder = tmp_path_factory.mktemp("runs") / "smoke"
    assert train.main(preset="smoke", out=folder, quiet=True) == 0
    return folder


@pytest.fixture
def browser():
    """Headless Chromium; must be there where CI runs."""
    webdriver = pytest.importorskip("selenium.webdriver")
    chromium, driver = shutil.which("chromium"), shutil.which("chromedriver")
    if not (chromium and driver):
        assert not os.environ.get("CI"), "CI must have Chromium and its driver"
        pytest.skip("Chromium or chromedriver is not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    for flag in (
        "--headless=new",
        "--no-sandbox",
        "--window-size=1000,700",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-dev-shm-usage",
    ):
        options.add_argument(flag)
    service = webdriver.ChromeService(executable_path=driver)
    opened = webdriver.Chrome(options=options, service=service)
    yield opened
    opened.quit()
