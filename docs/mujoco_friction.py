"""A step of a joint model in MuJoCo with the friction that grows with the load.

MJCF has no such friction. The file has its numbers mu_avg and mu_dif.
"""

import math

import mujoco

REST = 1e-3  # rad/s: speed of the output at which the friction has three quarters of its size


def step(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Advance the simulation by one timestep; `data.ctrl[0]` is the torque of the motor shaft, N m."""
    rotor = model.joint("rotor").dofadr[0]
    torque = data.ctrl[0] * model.actuator_gear[0, 0]  # at the output
    sense = math.tanh(data.qvel[rotor] / REST)
    average, difference = (model.numeric(name).data[0] for name in ("mu_avg", "mu_dif"))
    data.qfrc_applied[rotor] = -(average * abs(torque) * sense + difference * torque * sense**2)
    mujoco.mj_step(model, data)
