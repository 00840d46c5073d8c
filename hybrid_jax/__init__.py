# SPDX-License-Identifier: MIT
"""Hybrid robot learning for motion planning in manufacturing work cells, on JAX."""

import ctypes.util as _ctypes_util
import os as _os
import sys as _sys

# MuJoCo picks its off-screen renderer when it is first imported
_RENDERERS = {"egl": "EGL", "osmesa": "OSMesa"}
_asked = _os.environ.get("MUJOCO_GL", "").lower()
if _sys.platform == "linux" and _asked in _RENDERERS:
    if not _ctypes_util.find_library(_RENDERERS[_asked]):
        # importing MuJoCo would end in an error of another package
        _sys.stderr.write(
            f"MUJOCO_GL={_asked}: lib{_RENDERERS[_asked]} is not installed, nothing is drawn\n"
        )
        del _os.environ["MUJOCO_GL"]
elif _sys.platform == "linux" and not (_asked or _os.environ.get("DISPLAY")):
    _found = [name for name, library in _RENDERERS.items() if _ctypes_util.find_library(library)]
    if _found:
        _os.environ["MUJOCO_GL"] = _found[0]

__version__ = "0.1.0"

_EXPORTS = {
    "load_workcell": "workcell.load",
    "Workcell": "types",
    "Trajectory": "types",
    "Status": "types",
    "tool_pose": "kernels.kinematics",
    "jacobian": "kernels.kinematics",
    "manipulability": "kernels.kinematics",
    "clearance": "kernels.collision.clearance",
    "edge_is_free": "kernels.collision.motion_validation",
    "sense": "kernels.rays",
    "use_all_cores": "runtime.devices",
    "IkConfig": "ik",
    "IkResult": "ik",
    "solve_ik": "ik",
    "MapConfig": "feasibility.grid",
    "FeasibilityMap": "feasibility.building",
    "build_feasibility_map": "feasibility.building",
    "save_map": "feasibility.map_files",
    "load_map": "feasibility.map_files",
    "query": "feasibility.lookup",
    "nearest_feasible": "feasibility.lookup",
    "SkillLibrary": "skills.library",
    "build_library": "skills.library",
    "Task": "tasks.task",
    "make_task": "tasks.registry",
    "sample_scene": "tasks.scene_sampling",
    "Planner": "planner.records",
    "PlanResult": "contracts",
    "PlannerConfig": "planner.records",
    "plan_motion": "planner.pipeline",
    "plan_batch": "planner.pipeline",
    "plan_joint_motion": "planner.point_to_point",
    "JointMotionConfig": "planner.point_to_point",
    "read_task": "tasks.registry",
    "open_run": "runs.run_folder",
    "load_planner": "runs.load_planner",
    "ExecutionConfig": "execution.plan_execution",
    "execute": "execution.single_tasks",
    "ExecutionReport": "execution.single_tasks",
    "sort_scenes": "execution.handling",
    "SortingReport": "execution.handling",
    "write_plan": "export.files",
    "export_policy": "export.policies",
    "HybridJaxError": "errors",
}
__all__ = sorted(_EXPORTS)


def __getattr__(name: str):
    """Import a public name when it is first used: `import hybrid_jax` itself stays quick."""
    if name not in _EXPORTS:
        raise AttributeError(f"module 'hybrid_jax' has no attribute {name!r}")
    import importlib

    return getattr(importlib.import_module(f"hybrid_jax.{_EXPORTS[name]}"), name)


def __dir__():
    return __all__
