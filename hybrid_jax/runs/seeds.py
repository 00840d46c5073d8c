# SPDX-License-Identifier: MIT
"""All ranges of seeds that scenes, tasks and cells are drawn from, and the use of each.

A seed decides a scene wholly. So a range that was used for training, tuning or inspection says
nothing about new scenes. A test proves that no two ranges overlap. A held-out range whose results
have led to a change is spent: it moves to `SEEN`, and the study to a new range.
"""

EXAMPLES = range(0, 10_000)
"""Demonstrations of a run, documents, tests, `check`: seen during development."""
SPENT = range(10_000, 1_000_000)
"""Studies and benchmarks up to version 0.1.0: some were used for training, all were seen."""

TRAINING = range(1_000_000, 1_100_000)
"""Tasks that the agents of a run train on."""
BENCHMARK_TRAINING = range(1_100_000, 1_200_000)
"""Tasks that the agents of benchmarks train on: joint agent, switching, planning."""
LFD_TRAINING = range(1_200_000, 1_300_000)
"""Tasks that the hierarchical DQN of a benchmark trains on."""
VALIDATION = range(2_000_000, 2_100_000)
"""Held-out segments and tasks that a training reports on; settings are chosen by them."""

HANDLING_STUDY = range(5_000_000, 5_010_000)
"""Scenes of the handling study."""
INSPECTION_STUDY = range(5_100_000, 5_200_000)
"""Trials of the inspection study: scene, start and part."""
SINGLE_TASK_STUDY = range(5_800_000, 5_810_000)
"""Tasks of kinds that have no study of their own."""
PLANNING_TEST = range(5_200_000, 5_210_000)
"""Tasks that planners are compared on."""
PLANNING_WARM_UP = range(5_210_000, 5_220_000)
"""Tasks that planners are compiled on before a comparison."""
PLANNING_BATCHES = range(5_220_000, 5_300_000)
"""Tasks that are planned in batches."""
SWITCHING_TEST = range(5_300_000, 5_310_000)
"""Tasks whose phases the switching agent is tested on."""
JOINT_AGENT_TEST = range(5_400_000, 5_500_000)
"""Tasks whose gaps the joint agent is tested on."""
LFD_TEST = range(5_500_000, 5_600_000)
"""Tasks that the hierarchical DQN is tested on."""
HOLDING = range(5_600_000, 5_600_100)
"""Scenes in which objects are held."""
ROUND_TRIPS = range(5_700_000, 5_710_000)
"""Random arms and motions that are written to files, read back and followed."""
LATENCY = range(5_900_000, 5_910_000)
"""Tasks whose first plans are timed, in fresh processes and in long ones."""

SEEN = ("EXAMPLES", "SPENT", "TRAINING", "BENCHMARK_TRAINING", "LFD_TRAINING", "VALIDATION")
"""Names of the ranges used for training, tuning or inspection."""
HELD_OUT = (
    "HANDLING_STUDY",
    "INSPECTION_STUDY",
    "SINGLE_TASK_STUDY",
    "PLANNING_TEST",
    "PLANNING_WARM_UP",
    "PLANNING_BATCHES",
    "SWITCHING_TEST",
    "JOINT_AGENT_TEST",
    "LFD_TEST",
    "HOLDING",
    "ROUND_TRIPS",
    "LATENCY",
)
"""Names of the ranges of studies and tests."""
