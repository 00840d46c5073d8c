# SPDX-License-Identifier: MIT
"""Two engines that simulate many cells at once: C MuJoCo on all cores, and MJX.

A state is MuJoCo's full physics state `[time, qpos, qvel, act]`. A command is the actuators'
controls, then a 0 or 1 for each equality: is it active? Both engines take and return the same
arrays.
"""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
from jaxtyping import Bool, Float
from mujoco import mjx, rollout

from hybrid_jax.errors import InputError, UnknownNameError
from hybrid_jax.execution.contact_sensors import SensedCell
from hybrid_jax.mjx.physics import device_model
from hybrid_jax.runtime.compiler_options import quick_options
from hybrid_jax.runtime.devices import usable_cores

_STATE = mujoco.mjtState.mjSTATE_FULLPHYSICS
_COMMAND = mujoco.mjtState.mjSTATE_CTRL | mujoco.mjtState.mjSTATE_EQ_ACTIVE

ENGINES = "auto", "mujoco", "mjx"
"""Names of engines."""

States = Float[np.ndarray, "run step state"]
Touching = Bool[np.ndarray, "run step mover thing"]


def get_state(model: mujoco.MjModel, data: mujoco.MjData) -> Float[np.ndarray, " state"]:
    """Full physics state `[state]` of a simulation: time [s], `qpos`, `qvel`, `act`."""
    state = np.empty(mujoco.mj_stateSize(model, _STATE))
    mujoco.mj_getState(model, data, state, _STATE)
    return state


class HostEngine:
    """C MuJoCo: the runs are shared out over all cores."""

    def __init__(self, sensed: SensedCell):
        self.sensed, threads = sensed, usable_cores()
        self.data = [mujoco.MjData(sensed.model) for _ in range(threads)]
        self.pool = rollout.Rollout(nthread=threads if threads > 1 else 0)

    def roll(
        self,
        models: Sequence[mujoco.MjModel],
        states: Float[np.ndarray, "run state"],
        commands: Float[np.ndarray, "run step command"],
    ) -> tuple[States, Touching]:
        """Simulate all runs through all steps.

        Args:
            models: one for each run; they may differ in numbers, not in size.
            states: `[run, state]` to begin with.
            commands: `[run, step, command]` controls and active equalities of every step.

        Returns:
            States `[run, step, state]` after each step, and contacts `[run, step, mover, thing]`.
        """
        handler = mujoco.get_mju_user_warning()
        mujoco.set_mju_user_warning(lambda text: None)  # a run that blows up is told by its state
        try:
            rolled, counts = self.pool.rollout(
                list(models), self.data, states, commands, control_spec=int(_COMMAND)
            )
        finally:
            mujoco.set_mju_user_warning(handler)
        return rolled, self.sensed.touching(counts)


class DeviceEngine:
    """MJX: all runs in one batch on the default device, in float32.

    Smaller batches are filled up to the size of the largest, since every size compiles anew.
    """

    def __init__(self, sensed: SensedCell):
        self.size = 0
        self.sensed, self.first, self.second = sensed, *map(jnp.asarray, sensed.geoms())

    def roll(
        self,
        models: Sequence[mujoco.MjModel],
        states: Float[np.ndarray, "run state"],
        commands: Float[np.ndarray, "run step command"],
    ) -> tuple[States, Touching]:
        """Simulate all runs from states `[run, state]`; shapes are those of `HostEngine.roll`.

        Raises:
            InputError: the runs do not share one model.
        """
        if any(model is not models[0] for model in models):
            raise InputError("MJX rolls runs of one model only: give each model a call of its own")
        run, count = _rolling(_ById(models[0])), len(states)
        self.size = max(self.size, count)
        rows = np.minimum(np.arange(self.size), count - 1)
        rolled, counts = run(
            self.first, self.second, jnp.asarray(states[rows]), jnp.asarray(commands[rows])
        )
        rolled, counts = np.array(rolled[:count], float), np.asarray(counts[:count])
        # float32 loses the last digits of the time, so it is counted anew in float64
        steps = np.arange(1, rolled.shape[1] + 1) * models[0].opt.timestep
        rolled[..., 0] = states[:, :1] + steps
        return rolled, self.sensed.touching(counts)


def make_engine(sensed: SensedCell, name: str = "auto") -> HostEngine | DeviceEngine:
    """An engine by its name: mujoco (in C, on all cores), mjx, or auto.

    `auto` is MJX on an accelerator and C MuJoCo on a CPU, where it is hundreds of times faster.

    Raises:
        UnknownNameError: no such engine.
    """
    if name not in ENGINES:
        raise UnknownNameError("engine", name, ENGINES)
    if name == "auto":
        name = "mujoco" if jax.default_backend() == "cpu" else "mjx"
    return HostEngine(sensed) if name == "mujoco" else DeviceEngine(sensed)


class _ById:
    """Key of a cache that compares models by identity, and keeps them alive."""

    def __init__(self, model: mujoco.MjModel):
        self.model = model

    def __eq__(self, other):
        return isinstance(other, _ById) and self.model is other.model

    def __hash__(self):
        return id(self.model)


@functools.lru_cache(maxsize=2)
def _rolling(key: _ById):
    """Compiled rollout of a model: masks, states, commands to states and contact counts."""
    model = device_model(key.model)
    device, blank = mjx.put_model(model), mjx.make_data(model)
    nq, nv, nu = model.nq, model.nv, model.nu

    def roll(first, second, state, commands):
        data = blank.replace(
            time=state[0],
            qpos=state[1 : 1 + nq],
            qvel=state[1 + nq : 1 + nq + nv],
            act=state[1 + nq + nv :],
        )

        def step(data, command):
            active = command[nu:] > 0.5
            data = mjx.step(device, data.replace(ctrl=command[:nu], eq_active=active))
            contact = data._impl.contact
            a, b = contact.geom.T
            touching = contact.dist < 0
            pairs = (first[:, a] & second[:, b]) | (first[:, b] & second[:, a])
            state = jnp.concatenate([data.time[None], data.qpos, data.qvel, data.act])
            return data, (state, (pairs & touching).sum(axis=1))

        return jax.lax.scan(step, data, commands)[1]

    rolled = jax.vmap(roll, in_axes=(None, None, 0, 0))
    return jax.jit(rolled, compiler_options=quick_options())
