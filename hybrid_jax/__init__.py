# SPDX-License-Identifier: MIT
"""Hybrid robot learning for motion planning in manufacturing work cells, on JAX."""

import ctypes.util as _ctypes_util
import os as _os
import sys as _sys

if "MUJOCO_GL" not in _os.environ and _sys.platform == "linux" and not _os.environ.get("DISPLAY"):
    # MuJoCo picks its off-screen renderer when it is first imported
    _found = [name for name in ("EGL", "OSMesa") if _ctypes_util.find_library(name)]
    if _found:
        _os.environ["MUJOCO_GL"] = _found[0].lower()

__version__ = "0.1.0"

_EXPORTS = {
    "load_workcell": "workcell.load",
    "Workcell": "types",
    "Trajectory": "types",
    "Status": "types",
    "tool_pose": "kernels.kinematics",
    "jacobian": "kernels.kinematics",
    "manipulability": "kernels.kinematics",
    "clearance": "kernels.collision",
    "edge_is_free": "kernels.edges",
    "sense": "kernels.rays",
    "use_all_cores": "devices",
    "IkConfig": "ik",
    "IkResult": "ik",
    "solve_ik": "ik",
    "MapConfig": "feasibility.grid",
    "FeasibilityMap": "feasibility.building",
    "build_feasibility_map": "feasibility.building",
    "save_map": "feasibility.building",
    "load_map": "feasibility.building",
    "query": "feasibility.lookup",
    "nearest_feasible": "feasibility.lookup",
    "SkillLibrary": "skills.library",
    "build_library": "skills.library",
    "Task": "skills.task",
    "handling_task": "skills.handling",
    "inspection_task": "skills.inspection",
    "make_task": "skills.tasks",
    "sample_scene": "skills.scenes",
    "Planner": "planner.records",
    "PlanResult": "planner.records",
    "PlannerConfig": "planner.records",
    "plan_motion": "planner.pipeline",
    "plan_batch": "planner.pipeline",
    "plan_joint_motion": "planner.joints",
    "JointMotionConfig": "planner.joints",
    "read_task": "skills.tasks",
    "open_run": "runfolder",
    "load_planner": "planner.loading",
    "ExecutionConfig": "simulation.execution",
    "execute": "simulation.runs",
    "ExecutionReport": "simulation.runs",
    "sort_scenes": "simulation.runs",
    "SortingReport": "simulation.runs",
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
