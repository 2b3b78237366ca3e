"""A tour of jaxftc, to be pasted piece by piece into a Python prompt, or run as a whole: ``python docs/tutorial.py``.

Engine "chain" and 0.3 s of motion keep it short; most of the time goes into compiling, once for each kind of program.
"""

# --------------------------------------------------------------------------------------
# 1. Set up
#
# Settings of JAX, before it is first used: a folder where compiled programs are
# kept for the next time, and, for the control loop at the end, one that saves a change
# of threads in every tick.

import os
import tempfile
from pathlib import Path

os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA warns at length when a program comes from the folder

import jax
import jax.numpy as jnp
import mujoco
import numpy as np

import jaxftc

folder = Path(tempfile.gettempdir()) / "jaxftc-tutorial"
jax.config.update("jax_compilation_cache_dir", str(folder / "programs"))
jax.config.update("jax_cpu_enable_async_dispatch", False)
jaxftc.configure_xla()  # your own jax.jit, vmap and grad compile as the library does

# A config is what is fixed before anything is compiled: the arm, the sample time, the
# structure. Gains are what may change.

robot = jaxftc.puma560(coulomb=False)  # or jaxftc.load_robot("arm.xml"), your own
config = jaxftc.Config(robot, engine="chain", duration=0.3)  # 300 ticks of 1 ms
gains = jaxftc.default_gains(config)

# --------------------------------------------------------------------------------------
# 2. A healthy run
#
# simulate() closes the loop: motion, faults, encoder noise, controller, arm. Arrays of
# a trace are [ticks, joints].

scenario = jaxftc.paper_scenario("healthy", config)
healthy = jaxftc.simulate(config, gains, scenario, jax.random.key(0))

error = np.rad2deg(np.abs(healthy.q - healthy.q_ref)).max()
share = (np.abs(healthy.out.statistic_tau) / healthy.out.threshold_tau).max()
print(f"healthy: at most {error:.3f} deg off the reference")
print(f"torque statistic: at {100 * share:.0f} % of its threshold")
print("alarms:", int(healthy.out.detected.sum()))

# --------------------------------------------------------------------------------------
# 3. A fault
#
# 5 N m too much in every motor, from 0.1 to 0.25 s. The verdict of a joint is 0 normal,
# 1 actuator, 2 sensor, 3 both.

scenario = jaxftc.paper_scenario("actuator", config)
faulty = jaxftc.simulate(config, gains, scenario, jax.random.key(0))

first = int(np.argmax(faulty.out.detected))
print(f"first alarm {first - 100} ms after onset")
print("verdicts 60 ms later:", faulty.out.verdict[first + 60])
print("estimated, N m:", np.asarray(faulty.out.fault_tau_hat[220]).round(1))
print("true, N m:     ", faulty.fault_tau[220])

# A scenario is a bundle of arrays, so a fault on one joint is a change of one array.
# Here only the encoder of joint 2 jumps.

scenario = jaxftc.paper_scenario("sensor", config)
only_joint_2 = jnp.asarray([0, 1, 0, 0, 0, 0], jnp.int32)
fault = scenario.fault_q._replace(kind=scenario.fault_q.kind * only_joint_2)
scenario = scenario._replace(fault_q=fault)
jumped = jaxftc.simulate(config, gains, scenario, jax.random.key(0))

angle = np.rad2deg(jumped.out.fault_q_hat[160, 1])
print(f"encoder of joint 2: verdict {jumped.out.verdict[160]}, estimated {angle:.2f} deg")

# --------------------------------------------------------------------------------------
# 4. Thresholds
#
# An alarm is a statistic that reaches its threshold. Ten times smaller ones alarm
# without a fault, twenty times larger ones miss what is there. Gains are frozen:
# replace() makes others.


def with_thresholds(gains, factor):
    """The gains with all torque thresholds times a factor."""
    alpha_tau = factor * gains.diagnosis.alpha_tau
    return gains.replace({"diagnosis.alpha_tau": alpha_tau})


for factor, condition in ((0.1, "healthy"), (20.0, "actuator")):
    some = with_thresholds(gains, factor)
    scenario = jaxftc.paper_scenario(condition, config)
    out = jaxftc.simulate(config, some, scenario, jax.random.key(0)).out
    alarms = int(out.detected.sum())
    print(f"{condition}, thresholds times {factor:g}: {alarms} ticks with an alarm")

# --------------------------------------------------------------------------------------
# 5. Gains of your own
#
# A file of gains says the unit of every number, and which arm, sample time and orders
# they belong to.

steeper = gains.replace({"control.lam": 1.5 * gains.control.lam})

jaxftc.save_gains(folder / "gains.toml", steeper, config)
steeper = jaxftc.load_gains(folder / "gains.toml", config)

scenario = jaxftc.paper_scenario("actuator", config)
for name, some in (("default", gains), ("steeper surface", steeper)):
    trace = jaxftc.simulate(config, some, scenario, jax.random.key(0))
    error = np.rad2deg(np.sqrt(np.mean((trace.q - trace.q_ref) ** 2)))
    print(f"{name}: tracking error {error:.3f} deg rms")

# --------------------------------------------------------------------------------------
# 6. A gradient
#
# Everything but the verdict is differentiable, through plant, faults, observer and
# controller. Your own jax.jit compiles it as the library compiles its own programs,
# since configure_xla was called at the start.


def torque_error(alpha_i):
    """Mean square error of the torque-fault estimate, (N m)^2, by integral gains [n]."""
    some = gains.replace({"observer.alpha_i": alpha_i})
    trace = jaxftc.simulate(config, some, scenario, jax.random.key(0))
    return jnp.mean((trace.out.fault_tau_hat - trace.fault_tau) ** 2)


value_and_slope = jax.jit(jax.value_and_grad(torque_error))
before, slope = value_and_slope(gains.observer.alpha_i)
after, _ = value_and_slope(gains.observer.alpha_i * jnp.exp(-0.3 * jnp.sign(slope)))
print(f"one step against the gradient: {before:.3f} -> {after:.3f} (N m)^2")

# jaxftc tune does this for all gains at once, over batches of scenarios, and compares
# on scenarios that it has not seen.

# --------------------------------------------------------------------------------------
# 7. A batch of scenarios
#
# Drawn scenarios have a leading axis, and so has every leaf of their trace. The same
# code runs one arm or a thousand side by side.

drawn = jaxftc.sample_scenarios(jax.random.key(1), 200, config=config)
batch = jax.tree.map(lambda leaf: leaf[:8], drawn)
trace = jaxftc.simulate(config, gains, batch, jax.random.key(2))
print("verdicts at the end, [scenarios, joints]:")
print(np.asarray(trace.out.verdict[:, -1]))

# --------------------------------------------------------------------------------------
# 8. A campaign of a few runs
#
# Thresholds first: the arms that are drawn are not exactly the model, so those of the
# exact model would cry wolf. calibrate() sets them on healthy runs, here for one run in
# ten with an alarm. campaign() scores faults: a dict of columns, a row a run.

result = jaxftc.calibrate(config, gains, drawn, jax.random.key(3), false_alarms=0.1)
calibrated = result.gains
print("torque thresholds, N m:", np.asarray(calibrated.diagnosis.alpha_tau).round(2))

rows = jaxftc.campaign(config, calibrated, drawn, jax.random.key(4))
begun = (rows["kind"] != "normal") & (rows["onset_s"] < 0.2)
found = 100 * rows["detected"][begun].mean()
print(f"{begun.sum()} faults with at least 0.1 s to be seen, {found:.0f} % found")
for kind in ("actuator", "sensor"):
    delay = rows["delay_s"][begun & (rows["kind"] == kind)]  # infinite if missed
    print(f"{kind}: median delay of {len(delay)} is {1e3 * np.median(delay):.0f} ms")

# --------------------------------------------------------------------------------------
# 9. In a control loop
#
# Tick is the controller as it runs on a robot: NumPy in, NumPy out, one array of state,
# no plant and no truth. The robot here is MuJoCo's own simulation of the same arm; read
# your encoders and send your torques in its place. plant_model() has motors in N m, and
# the robot's friction, whatever actuators its file has.

model = robot.plant_model(config.dt)
data = mujoco.MjData(model)
data.qpos[:] = np.deg2rad([30.0, 90.0, 30.0, 120.0, 50.0, 180.0])

tick = jaxftc.Tick(config, gains)  # compiles here, before the robot moves
state = tick.init(data.qpos)
tau = np.full(robot.n, np.nan)  # nothing was commanded yet
hold = jaxftc.Reference(data.qpos.copy(), np.zeros(robot.n), np.zeros(robot.n))

for k in range(300):
    state, out = tick.step(state, hold, jaxftc.Measurement(data.qpos, tau))
    if out.detected:
        print(f"{k} ms: verdict {out.verdict}, {out.fault_tau_hat[2]:.1f} N m in joint 3")
        break
    tau = out.tau
    data.ctrl[: robot.n] = tau
    data.qfrc_applied[2] = 4.0 if k >= 150 else 0.0  # a fault in the motor of joint 3
    mujoco.mj_step(model, data)
