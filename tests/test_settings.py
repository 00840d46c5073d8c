# SPDX-License-Identifier: MIT
"""Own settings: options and files change a preset, a run keeps what it was begun with."""

import json
from dataclasses import replace

import pytest

from hybrid_jax import train
from hybrid_jax.agents.sac import SacConfig
from hybrid_jax.envs.paper_reach import PaperReachConfig
from hybrid_jax.errors import InputError, RunFolderError, UnknownNameError
from hybrid_jax.runs import own_settings
from hybrid_jax.runs.own_settings import Changes
from hybrid_jax.runs.presets import PRESETS, SMOKE, Preset, find_preset
from hybrid_jax.runs.run_folder import Run, create_run, open_run
from hybrid_jax.runs.settings import as_values, differences, from_values, merged

OTHER_KINDS = replace(
    SMOKE, joint=replace(SMOKE.joint, training=SacConfig(steps=7), reach=PaperReachConfig())
)


@pytest.mark.parametrize("preset", [*PRESETS.values(), OTHER_KINDS], ids=[*PRESETS, "sac"])
def test_settings_are_read_back_as_they_were(preset):
    text = json.dumps(as_values(preset))
    assert from_values(Preset, json.loads(text), "settings") == preset


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"joint": {"training": {"steps": 1.5}}},
            "joint.training.steps is 1.5; it must be a whole number",
        ),
        ({"joint": {"training": {"steps": True}}}, "joint.training.steps is True"),
        ({"map": {"tilts": [0.0, "a"]}}, "map.tilts is"),
        ({"map": {"lower": [0.0, 1.0]}}, "map.lower is"),
        ({"map": {"spacing": -1}}, "the grid is empty"),
        ({"maps": {}}, "maps is unknown; there are: map"),
        ({"task_planner": "guess"}, "task_planner is 'guess'"),
        ({"joint": {"training": {"kind": "Td3Config"}}}, "it must be one of: PpoConfig, SacConfig"),
        ({"joint": {"training": {"kind": "SacConfig"}}}, "joint.training.batch is missing"),
        ({"planner": 3}, "planner is 3"),
        ({"map": {"ik": {"seeds": 0}}}, "map.ik: seeds and iterations must be at least 1"),
        ({"map": {"spacing": float("nan")}}, "map.spacing is nan; it must be a finite number"),
        ({"joint": {"rollouts": 8}}, "joint.rollouts is 8; it must be a list, each item a whole"),
    ],
)
def test_a_wrong_setting_is_named(change, message):
    with pytest.raises(InputError, match=message):
        from_values(Preset, merged(as_values(SMOKE), change, "file"), "file")


def test_a_file_then_options_change_a_preset(tmp_path):
    file = tmp_path / "own.json"
    file.write_text('{"tasks": 9, "joint": {"training": {"steps": 640}}, "fallback": null}')
    found = own_settings.changed(
        SMOKE, Changes(file, options=("--tasks", "11", "--joint.rollouts", "2", "3"))
    )
    assert list(differences(SMOKE, found)) == [
        ("joint.training.steps", 16_384, 640),
        ("joint.rollouts", SMOKE.joint.rollouts, (2, 3)),
        ("fallback", SMOKE.fallback, None),
        ("tasks", 4, 11),
    ]
    file.write_text(json.dumps({"preset": "smoke", "configuration": as_values(found)}))
    assert own_settings.changed(SMOKE, Changes(file)) == found
    file.write_text("{")
    with pytest.raises(InputError, match=r"own\.json"):
        own_settings.changed(SMOKE, Changes(file))


def test_backend_and_physics_change_all_that_uses_them():
    on_mjx = own_settings.changed(SMOKE, Changes(backend="mjx", physics="mjx"))
    assert [name for name, _, _ in differences(SMOKE, on_mjx)] == [
        "map.backend",
        "joint.reach.backend",
        "joint.reach.physics",
        "switch.backend",
        "switch.physics",
        "planner.check.backend",
    ]
    kept = own_settings.changed(on_mjx, Changes(physics="kinematic"))
    assert kept.joint.reach.backend == "mjx" and kept.joint.reach.physics == "kinematic"
    with pytest.raises(InputError, match="preset 'paper'"):
        own_settings.changed(find_preset("paper"), Changes(backend="mjx"))


def test_options_of_the_command_and_settings_are_told_apart():
    plain, settings = train.split_settings(
        ["map", "--joint.rollouts", "4", "8", "--quiet", "--tasks=3", "--map.tilts", "-0.6", "0",
         "--out", "a", "--workcel", "b"]
    )  # fmt: skip
    assert plain == ["map", "--quiet", "--out", "a", "--workcel", "b"]
    assert settings == (
        "--joint.rollouts", "4", "8", "--tasks=3", "--map.tilts", "-0.6", "0"
    )  # fmt: skip


def test_a_run_keeps_its_settings(tmp_path):
    own = replace(SMOKE, tasks=5)
    create_run("gen3_handling", "smoke", 0, tmp_path / "run", settings=own)
    run = open_run(tmp_path / "run")
    assert run.preset == own and run.preset_name == "smoke"
    own_settings.refuse_other_settings(
        run, {"seed": 0, "preset_name": None}, Changes(options=("--tasks", "5"))
    )
    with pytest.raises(RunFolderError, match="begun with tasks 5, not 6"):
        own_settings.refuse_other_settings(run, {}, Changes(options=("--tasks", "6")))
    with pytest.raises(RunFolderError, match="begun with seed 0, not 3"):
        own_settings.refuse_other_settings(run, {"seed": 3}, Changes())


def test_a_run_of_the_former_format_is_refused(tmp_path):
    create_run("gen3_handling", "smoke", 0, tmp_path)
    path = tmp_path / "config.json"
    values = json.loads(path.read_text())
    path.write_text(json.dumps({k: v for k, v in values.items() if k != "format"}))
    with pytest.raises(
        RunFolderError, match="of format 1, this version reads 5: train the run anew"
    ):
        open_run(tmp_path)
    values["configuration"]["planner"]["labels"] = values["configuration"]["planner"].pop("path_ik")
    path.write_text(json.dumps(values))
    with pytest.raises(RunFolderError, match=r"configuration\.planner\.labels is unknown"):
        open_run(tmp_path)


def test_without_own_settings_a_run_has_those_of_its_preset(cell, tmp_path):
    assert Run(tmp_path, cell, "smoke", 0).preset is SMOKE
    with pytest.raises(UnknownNameError, match="smoke"):
        find_preset("smok")
