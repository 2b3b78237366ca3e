"""Scores of a campaign from a stored trace, written down tick by tick as one would explain them."""

import numpy as np
from scipy import signal

from jaxftc.evaluation.online import LEVELS


def truth(config, scenario):
    """(wanted verdict [n], onset, clear) of one scenario; onset 0 and clear inf if nothing is wrong before the run's end."""
    last = (config.ticks - 1) * config.dt
    wanted, faults = np.zeros(config.n, int), []
    for bit, fault in ((1, scenario.fault_tau), (2, scenario.fault_q)):
        for j in range(config.n):
            if fault.kind[j] > 0 and fault.onset[j] <= last:
                wanted[j] += bit
                faults.append((fault.onset[j], fault.clear[j]))
    contact = scenario.contact
    if contact is not None and contact.size > 0 and contact.link > 0 and contact.onset <= last:
        wanted[: contact.link] += 8
        faults.append((contact.onset, contact.clear))
    if not faults:
        return wanted, 0.0, np.inf
    return wanted, float(min(onset for onset, _ in faults)), float(max(clear for _, clear in faults))


def visible_bits(trace, wanted):
    """Bits [T, n] of the faults that are as large as their thresholds, or without a reading; of a contact all its joints."""
    pushed = (np.abs(trace["contact_tau"]) >= trace["threshold_tau"]).any(1)
    tau = np.abs(trace["fault_tau"]) >= trace["threshold_tau"]
    q = (np.abs(trace["fault_q"]) >= trace["threshold_q"]) | np.isnan(trace["y"])
    return tau + 2 * q + 8 * (pushed[:, None] & (wanted >= 8))


def score(config, scenario, trace, at_rest):
    """Every field of Score for one run; ``trace`` is a column per signal, [T, n], ``at_rest`` [n] N m a threshold."""
    wanted, onset, clear = truth(config, scenario)
    healthy = not wanted.any()
    t, limit, dt = trace["t"], config.robot.torque_limit, config.dt
    tau = trace["tau"] / limit
    error = trace["q"] - trace["q_ref"]
    alarm, verdict = trace["detected"], trace["verdict"]

    high = signal.butter(2, 50.0, "highpass", fs=1 / dt)
    rough = np.stack([signal.lfilter(*high, x, zi=signal.lfilter_zi(*high) * x[0])[0] for x in tau.T], axis=1)

    false_ticks, false_events, false_at, alarm_at, quiet_at, began = 0, 0, np.inf, np.inf, np.inf, np.inf
    for k in range(len(t)):
        before = healthy or t[k] < onset
        excused = onset <= t[k] <= clear + 0.1
        if t[k] >= onset:
            began = min(began, t[k])
        if alarm[k] and before:
            false_ticks += 1
            false_events += k == 0 or not alarm[k - 1]
        if alarm[k] and (healthy or not excused):
            false_at = min(false_at, t[k])
        before_it = verdict[k - 1] if k else np.zeros(config.n, int)
        if excused and any(new & ~old for new, old in zip(verdict[k], before_it, strict=True)):
            alarm_at = min(alarm_at, t[k])
        if not alarm[k] and t[k] > clear:
            quiet_at = min(quiet_at, t[k])

    isolated_at = np.inf
    for k in range(len(t) - 19):
        if t[k] >= onset and (verdict[k : k + 20] == wanted).all():
            isolated_at = t[k]
            break

    force, guesses = 0.0, (False, False)
    if healthy:
        said = np.bitwise_or.reduce(verdict, axis=0)
    elif np.isfinite(alarm_at):
        first = int(np.flatnonzero(t == alarm_at)[0])
        said, force = verdict[min(first + 60, len(t) - 1)], trace["force"][min(first + 60, len(t) - 1)].max()
    else:
        said = np.zeros(len(wanted), int)

    settled, complete_at, bits = said, np.inf, visible_bits(trace, wanted)
    if not healthy and np.isfinite(alarm_at):
        last = max(first, min(first + 300, int(np.flatnonzero(t <= clear + 0.5 * dt)[-1])))
        settled = verdict[min(last, len(t) - 1)]
        guesses = tuple(trace["unsure"][min(k, len(t) - 1)].any() for k in (first + 60, last))
    up = np.zeros(len(wanted), int)
    for k in range(len(t)):
        if t[k] >= onset:
            up = verdict[k] & (up | ~(verdict[k - 1] if k else 0 * verdict[k]))  # by alarms that rose since onset
        if not healthy and onset <= t[k] <= clear + 0.1 and (up & wanted == wanted).all():
            complete_at = min(complete_at, t[k])
    ends = alarm_at + 0.06 + 0.5 * dt, max(alarm_at, min(alarm_at + 0.3, clear)) + 0.5 * dt
    visible, visible_late = (np.bitwise_or.reduce(bits[t <= end], axis=0) for end in ends)

    rise = trace["threshold_tau"] / at_rest
    lasting = np.zeros_like(trace["statistic_tau"])
    for k in range(config.alarm_ticks - 1, len(t)):
        lasting[k] = (np.abs(trace["statistic_tau"]) / rise)[k - config.alarm_ticks + 1 : k + 1].min(0)
    size_q = np.abs(trace["statistic_q"])
    ratio, top = np.zeros(len(t)), 0.0
    for k in range(len(t)):
        ratio[k] = max((lasting[k] / at_rest).max(), (size_q[k] / trace["threshold_q"][k]).max())
        if t[k] >= onset > t[k] - dt:
            top = 0.0
        if max(top, ratio[k]) < 1 and trace["suspect"][k].any():
            ratio[k] = np.inf
        top = max(top, ratio[k])
    rising = [(ratio >= level) & (np.r_[0.0, ratio[:-1]] < level) for level in LEVELS]
    early = np.ones(len(t), bool) if healthy else t < onset
    window = (t >= onset) & (t <= clear + 0.1)
    return {
        "se_tau": ((trace["fault_tau_hat"] - trace["fault_tau"] - trace["contact_tau"]) ** 2).sum(),
        "se_q": ((trace["fault_q_hat"] - trace["fault_q"]) ** 2).sum(),
        "ise": (error**2).sum(),
        "iae": np.abs(error).sum(),
        "itae": (t[:, None] * np.abs(error)).sum(),
        "track_max": np.abs(error).max(),
        "effort": (tau**2).sum(),
        "travel": np.abs(np.diff(tau, axis=0)).sum(),
        "rough": (rough**2).sum(),
        "saturated": (np.abs(tau) >= 1 - 1e-6).sum(),
        "peak": np.abs(tau).max(),
        "false_ticks": false_ticks,
        "false_events": false_events,
        "false_at": false_at,
        "began": began,
        "alarm_at": alarm_at,
        "isolated_at": isolated_at,
        "quiet_at": quiet_at,
        "verdict": said,
        "settled": settled,
        "complete_at": complete_at,
        "visible_at": min(t[bits.any(1)], default=np.inf),
        "visible": visible,
        "visible_late": visible_late,
        "unsure": guesses[0],
        "unsure_late": guesses[1],
        "force": force,
        "crossed": np.array([min(t[window & up], default=np.inf) for up in rising]),
        "healthy_tau": lasting[early].max(0, initial=0),
        "healthy_q": size_q[early].max(0, initial=0),
        "healthy_ratio": ratio[early].max(initial=0),
        "lost": not np.isfinite(trace["q"]).all(),
    }
