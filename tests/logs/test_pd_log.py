"""From a log to a diagnosis, on an arm that MuJoCo C simulates under a PD controller.

The arm is 5 % heavier than its file, and has dry friction that the file lacks.

The controller sees the faulty readings and works against the faulty motors, as on a robot. The logs hold readings, and the
torques that were commanded, at 1 kHz and at each lower rate every so many rows of that.
"""

import dataclasses

import mujoco
import numpy as np
import pytest

import jaxftc
from jaxftc import logs
from jaxftc.campaigns.log_thresholds import calibrate_on_logs, reading_noise
from jaxftc.identify import dynamics
from jaxftc.logs.log import Log
from jaxftc.logs.timeline import Timeline
from tests import small_logs

RATE, ON, SECONDS = 1000, 8.0, 12.0  # Hz; s, onset of faults; s
HEAVIER, DRY = 1.05, 0.02  # of the file's masses; of the torque limit
NOISE = 1e-5  # rad, of the encoder
ACTUATOR, ENCODER = 0.08, np.deg2rad(1.0)  # of the torque limit; rad
KP, KD = np.array([2000.0, 2000.0, 400.0]), np.array([80.0, 80.0, 8.0])  # N m/rad, N m s/rad


@pytest.fixture(scope="module")
def arm(tmp_path_factory):
    return geared(small_logs.robot(tmp_path_factory.mktemp("pd")))


def geared(arm):
    """The small arm with motors in its file, the elbow's weaker than the others."""
    return arm.replace(armature=small_logs.MOTOR, torque_limit=np.array([80.0, 80.0, 25.0]))


def plant(arm):
    """The arm as it is."""
    model = arm.plant_model(1 / RATE)
    model.body_mass *= HEAVIER
    model.body_inertia *= HEAVIER
    model.dof_frictionloss[:] = DRY * arm.torque_limit
    model.opt.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)  # MuJoCo's dry friction is one
    mujoco.mj_setConst(model, mujoco.MjData(model))
    return model


def exact(arm):
    """The same as a model of ours."""
    links = tuple(
        dataclasses.replace(link, mass=HEAVIER * link.mass, moment=HEAVIER * link.moment, inertia=HEAVIER * link.inertia)
        for link in arm.links
    )
    dry = DRY * arm.torque_limit
    return arm.replace(links=links, coulomb_positive=dry, coulomb_negative=dry)


def run(arm, seed, seconds=SECONDS, push=None, off=None):
    """Readings and commanded torques [T, n] at 1 kHz; ``push`` [n] N m is lost of the torques, ``off`` [n] rad added to the
    readings, from ``ON`` on."""
    model, rng = plant(arm), np.random.default_rng(seed)
    data = mujoco.MjData(model)
    _, q_ref, qd_ref, _ = small_logs.motion(seconds, RATE, seed)
    data.qpos[:], data.qvel[:] = q_ref[0], qd_ref[0]
    q, tau, last = np.empty_like(q_ref), np.empty_like(q_ref), q_ref[0]
    for k in range(len(q)):
        faulty = k >= ON * RATE
        q[k] = data.qpos + NOISE * rng.standard_normal(3)
        if off is not None and faulty:
            q[k] += off
        speed, last = (q[k] - last) * RATE if k else qd_ref[0], q[k]
        tau[k] = np.clip(KP * (q_ref[k] - q[k]) + KD * (qd_ref[k] - speed), -arm.torque_limit, arm.torque_limit)
        data.ctrl[:3] = tau[k] if push is None or not faulty else tau[k] - push
        mujoco.mj_step(model, data)
    return q, tau


def at_rate(rate, q, tau):
    """What a recorder of that rate keeps."""
    every = RATE // rate
    q, tau = q[::every], tau[::every]
    return Log(q, tau, np.arange(len(q)) / rate, 1 / rate)


@pytest.fixture(scope="module")
def healthy(arm):
    return [run(arm, seed, 24.0) for seed in (1, 2, 4, 5)]


@pytest.fixture(scope="module")
def faults(arm):
    """Logs at 1 kHz by joint and kind."""
    one = np.eye(3)
    made = {(j + 1, "actuator"): run(arm, 3, push=ACTUATOR * arm.torque_limit * one[j]) for j in range(3)}
    return made | {(j + 1, "sensor"): run(arm, 3, off=ENCODER * one[j]) for j in range(3)}


def calibrated(robot, offset, recorded):
    recorded = [log._replace(tau=log.tau - offset) for log in recorded]
    config = jaxftc.Config(robot, dt=recorded[0].dt, t_final=recorded[0].dt, engine="chain")
    gains = jaxftc.default_gains(config, noise=reading_noise(config, jaxftc.default_gains(config), recorded))
    return config, calibrate_on_logs(config, gains, recorded, false_alarms=0.01).gains


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1000, 500, 125, 100])
def test_an_identified_arm_is_diagnosed(arm, healthy, faults, rate):
    recorded = [at_rate(rate, *log) for log in healthy]
    found = dynamics(arm, recorded)
    config, gains = calibrated(found.robot, found.offset, recorded)
    _, ideal = calibrated(exact(arm), 0.0, recorded)
    assert (np.asarray(gains.diagnosis.alpha_tau) <= 2 * np.asarray(ideal.diagnosis.alpha_tau)).all()
    for (joint, kind), log in faults.items():
        log = at_rate(rate, *log)
        line = Timeline(config.robot.joint_names, config.dt)
        line.add(logs.diagnose(config, gains, log._replace(tau=log.tau - found.offset)), 0.0)
        events = line.finish()
        assert [(e.joint, e.kind) for e in events] == [(joint, kind)], events
        assert -2 / rate < events[0].start_s - ON < 0.3
