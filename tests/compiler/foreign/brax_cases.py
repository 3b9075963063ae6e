"""Functions of brax and of MuJoCo's mjx: mathematics of rigid bodies, kinematics, steps of small systems."""

from typing import Any

import jax.numpy as jnp
import mujoco
from brax import kinematics, math
from brax.base import Motion, System, Transform
from brax.generalized import pipeline as generalized
from brax.io import mjcf
from brax.positional import pipeline as positional
from brax.spring import pipeline as spring
from mujoco import mjx

from compiler.foreign.case import Case, normal

CART = """
<mujoco>
  <option timestep="0.01"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="0.1"/>
      <geom type="capsule" size="0.1" fromto="-0.1 0 0 0.1 0 0" mass="1" contype="0" conaffinity="0"/>
      <body name="pole">
        <joint name="hinge" type="hinge" axis="0 1 0" damping="0.05"/>
        <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.6" mass="0.3" contype="0" conaffinity="0"/>
        <body name="second" pos="0 0 0.6">
          <joint name="elbow" type="hinge" axis="0 1 0" damping="0.05"/>
          <geom type="capsule" size="0.05" fromto="0 0 0 0 0 0.6" mass="0.3" contype="0" conaffinity="0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="slide" gear="10"/></actuator>
</mujoco>
"""
"""Two poles on a cart."""
SYSTEM: System = mjcf.loads(CART)
MODEL = mjx.put_model(mujoco.MjModel.from_xml_string(CART))
DATA = mjx.make_data(MODEL)


def _unit(x: Any) -> Any:
    return x / jnp.linalg.norm(x)


def _transform(x: Any) -> Any:
    return Transform(pos=x[:3], rot=_unit(x[3:7]))


def _step(pipeline: Any) -> Any:
    """One step from joint angles, rates and force."""

    def step(q: Any, qd: Any, u: Any) -> Any:
        state = pipeline.step(SYSTEM, pipeline.init(SYSTEM, q, qd), u)
        return state.q, state.qd

    return step


def _of_model(what: Any, *fields: str) -> Any:
    def compute(q: Any, qd: Any) -> Any:
        data = what(MODEL, DATA.replace(qpos=q, qvel=qd))
        return tuple(getattr(data, f) for f in fields)

    return compute


def _mjx_step(q: Any, qd: Any, u: Any) -> Any:
    data = mjx.step(MODEL, DATA.replace(qpos=q, qvel=qd, ctrl=u))
    return data.qpos, data.qvel


JOINTS = normal((3,), (3,))
CASES = [
    Case("vector rotated by a quaternion", lambda v, q: math.rotate(v, _unit(q)), normal((3,), (4,))),
    Case("product of quaternions", math.quat_mul, normal((4,), (4,))),
    Case(
        "Euler angles to quaternion and back",
        lambda v: math.quat_to_euler(math.euler_to_quat(20 * v)),
        normal((3,)),
    ),
    Case(
        "quaternion that rotates one vector to another",
        lambda a, b: math.from_to(_unit(a), _unit(b)),
        normal((3,), (3,)),
    ),
    Case("composition of two frames", lambda a, b: _transform(a).do(_transform(b)), normal((7,), (7,))),
    Case(
        "motion vector in another frame",
        lambda x, w, v: _transform(x).inv_do(Motion(ang=w, vel=v)),
        normal((7,), (3,), (3,)),
    ),
    Case("forward kinematics", lambda q, qd: kinematics.forward(SYSTEM, q, qd), JOINTS),
    Case("step of the generalized pipeline", _step(generalized), normal((3,), (3,), (1,))),
    Case("step of the spring pipeline", _step(spring), normal((3,), (3,), (1,))),
    Case("step of the positional pipeline", _step(positional), normal((3,), (3,), (1,))),
    Case("mjx: kinematics", _of_model(mjx.kinematics, "xpos", "xquat"), JOINTS),
    Case("mjx: forward dynamics", _of_model(mjx.forward, "qacc"), JOINTS),
    Case("mjx: step", _mjx_step, normal((3,), (3,), (1,))),
]
