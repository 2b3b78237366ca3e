"""The tuning terms of one stored run, scenario by scenario in plain NumPy loops."""

import numpy as np


def share(x):
    return x / (1 + x)


def rms(x):
    return np.sqrt(np.mean(np.square(x)))


def logistic(x):
    return 1 / (1 + np.exp(-x))


def terms(config, scenario, trace):
    """All terms but stability, from one scenario and its columns [T, n]."""
    limit = config.robot.torque_limit
    t, ticks, n = trace["t"], len(trace["t"]), config.n
    faulty_tau, faulty_q = np.asarray(scenario.fault_tau.kind) > 0, np.asarray(scenario.fault_q.kind) > 0
    onsets = [*np.asarray(scenario.fault_tau.onset)[faulty_tau], *np.asarray(scenario.fault_q.onset)[faulty_q]]
    clears = [*np.asarray(scenario.fault_tau.clear)[faulty_tau], *np.asarray(scenario.fault_q.clear)[faulty_q]]
    onset = min(onsets, default=np.inf)
    ratio_tau = np.abs(trace["statistic_tau"]) / trace["threshold_tau"]
    ratio_q = np.abs(trace["statistic_q"]) / trace["threshold_q"]
    suspect = trace["suspect"] > 0
    actuator = np.where(suspect, 0.0, logistic((ratio_tau - 1) / 0.1))
    sensor = np.where(suspect, 1.0, logistic((ratio_q - 1) / 0.1))

    late = []
    for j in np.flatnonzero(faulty_tau | faulty_q):
        alarm = 1 - (1 - actuator[:, j]) * (1 - sensor[:, j])
        before = alarm[t < onset].max(initial=0.0)
        window = np.flatnonzero((t >= onset) & (t - onset < 0.1))
        seen = [alarm[window[0] : k + 1].max() for k in window]
        late.append(np.mean(1 - np.array(seen) * (1 - before)))

    false = 0.0
    for ratio in (ratio_tau, ratio_q):
        for j in range(n):
            peak = ratio[t < onset, j].max(initial=0.0)
            false += 0.1 * np.log1p(np.exp(np.log((peak + 1e-6) / 0.9) / 0.1))

    scores = []
    for k in range(ticks):
        healthy = not (faulty_tau | faulty_q).any()
        if healthy or (0.06 <= t[k] - onset < 0.16 and t[k] <= max(clears)):
            scores.append(np.sum((actuator[k] - faulty_tau) ** 2 + (sensor[k] - faulty_q) ** 2))
    travel = np.abs(np.diff(trace["tau"] / limit, axis=0)).sum(0).mean() / (ticks * config.dt)
    return {
        "fault_tau": share(rms((trace["fault_tau_hat"] - trace["fault_tau"]) / (0.05 * limit))),
        "fault_q": share(rms((trace["fault_q_hat"] - trace["fault_q"]) / np.deg2rad(0.2))),
        "tracking": share(rms((trace["q"] - trace["q_ref"]) / np.deg2rad(0.1))),
        "chattering": share(travel / 5.0),
        "effort": rms(trace["tau"] / limit),
        "delay": np.mean(late) if late else 0.0,
        "false_alarm": false,
        "isolation": np.mean(scores) if scores else 0.0,
    }
