"""Every sensor's step gives the same in generated C as in JAX."""

import ctypes
import shutil

import jax
import numpy as np
import pytest

from contracts.parts import key, motion
from trimtab.compiler.function import lower_function
from trimtab.compiler.native.build import build_library, load_library
from trimtab.core.record import to_arrays
from trimtab.loop.structure import strengthen_types
from trimtab.sensors.encoder import Encoder, Tachometer
from trimtab.sensors.gyro_dynamics import DelayedGyro
from trimtab.sensors.imu import GyroErrors, Imu
from trimtab.sensors.magnetometer import FloorSteel, Magnetometer, RunningMotor

SENSORS = {
    "imu": Imu.microstrain_3dm_gx1(lever_arm=(0.1, 0.0, 0.02)),
    "delayed-gyro": Imu(gyro=GyroErrors(response=DelayedGyro(), noise=1e-3)),
    "magnetometer": Magnetometer.microstrain_3dm_gx1(disturbances=(RunningMotor(), FloorSteel())),
    "encoder": Encoder(eccentricity=0.01),
    "tachometer": Tachometer(),
}


@pytest.mark.thorough("imu", "delayed-gyro", "magnetometer")
@pytest.mark.skipif(not shutil.which("gcc"), reason="no gcc here")
@pytest.mark.parametrize("name", SENSORS)
def test_generated_c_step_matches_jax(name):
    sensor = to_arrays(SENSORS[name])

    def step(sensor, state, t):
        return strengthen_types(sensor.step(t, state, motion(t)))

    state = jax.tree.map(np.asarray, strengthen_types(sensor.init(key(3))))
    leaves, tree = jax.tree.flatten((sensor, state, np.int64(0)))
    program = lower_function(lambda *a: jax.tree.leaves(step(*jax.tree.unflatten(tree, a))), leaves)
    function = load_library(build_library(program.text("go"))).go
    compiled = jax.jit(step)
    for k in range(4):
        t = np.int64(k * sensor.period)
        wanted = compiled(sensor, state, t)
        outs = [np.zeros(np.shape(w), w.dtype) for w in jax.tree.leaves(wanted)]
        ins = [np.ascontiguousarray(a) for a in jax.tree.leaves((sensor, state, t))]
        pointers = [(ctypes.c_void_p * len(a))(*(x.ctypes.data for x in a)) for a in (ins, outs)]
        function(*pointers, ctypes.c_int32(1))
        for a, w in zip(outs, jax.tree.leaves(wanted), strict=True):
            np.testing.assert_allclose(a, w, rtol=1e-11, atol=1e-14)
        state = jax.tree.map(np.asarray, wanted[0])
