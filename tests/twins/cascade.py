"""One tick of the observer cascade, Eqs. (6) to (10), (13) and (15), corrected."""

import numpy as np

Array = np.ndarray


def sign(x: Array, eps: float | None) -> Array:
    """Hard sign for eps = None, otherwise tanh(x / eps) with eps in the unit of x."""
    return np.sign(x) if eps is None else np.tanh(x / eps)


def gaussian(x: Array, centre: float, width: float) -> Array:
    """Gaussian grade exp(-(x - centre)^2 / (2 width^2)), 0..1."""
    return np.exp(-0.5 * ((x - centre) / width) ** 2)


def set_grades(u: Array, centres: Array, widths: Array) -> tuple[Array, Array]:
    """Grades of the input u >= 0 (unitless) in the sets "zero" and "at threshold", Figure 5.

    centres and widths are (zero, at). The input saturates at the centre of "at", so that a large fault is fully "at".
    """
    u = np.minimum(u, centres[1])
    return gaussian(u, centres[0], widths[0]), gaussian(u, centres[1], widths[1])


def rule_weights(
    u_tau: Array, u_jump: Array, centres_tau: Array, widths_tau: Array, centres_jump: Array, widths_jump: Array
) -> tuple[Array, Array, Array, Array]:
    """Normalised weights of the four T-S rules of Eq. (9): (normal, actuator, sensor, both), each [n], sum 1.

    u_tau = |residual_tau| / threshold_tau and u_jump = |jump| / J, unitless. The weight of a rule is the product of
    the grades of its two premises.
    """
    tau_zero, tau_at = set_grades(u_tau, centres_tau, widths_tau)
    jump_zero, jump_at = set_grades(u_jump, centres_jump, widths_jump)
    normal = tau_zero * jump_zero
    actuator = tau_at * jump_zero
    sensor = tau_zero * jump_at
    both = tau_at * jump_at
    total = normal + actuator + sensor + both
    return normal / total, actuator / total, sensor / total, both / total


def sensor_grade(u_jump: Array, centres_jump: Array, widths_jump: Array) -> Array:
    """Share h_s, 0..1, of the two rules of Eq. (9) whose premise on the jump is "at threshold".

    The weights are products, so the share does not depend on the torque input; it is taken here at u_tau = 0 with any
    two proper sets. That breaks the loop residual_tau -> h_s -> psi_SM -> residual_tau.
    """
    unit = np.array([0.0, 1.0]), np.array([1.0, 1.0])
    _, _, sensor, both = rule_weights(np.zeros_like(u_jump), u_jump, *unit, centres_jump, widths_jump)
    return sensor + both


def advance(
    x: Array, y_hat: Array, e: Array, v: Array, psi: Array, a: Array, b_y: Array, b_v: Array, alpha_p: float
) -> Array:
    """Next bank states [n, N], Eq. (6) corrected: A x + b_y (y_hat + alpha_p e) + b_v (v + psi), joint by joint.

    y_hat, e [n] rad; v, psi [n] rad/s^2; alpha_p in (0, 1] or [n].
    """
    x_next = np.zeros_like(x)
    alpha_p = np.broadcast_to(alpha_p, y_hat.shape)
    for j in range(len(y_hat)):
        x_next[j] = a @ x[j] + b_y * (y_hat[j] + alpha_p[j] * e[j]) + b_v * (v[j] + psi[j])
    return x_next


def tick(
    y: Array,
    x: Array,
    b: Array,
    e_prev: Array,
    psi_pi: Array,
    g: Array,
    psi_f: Array,
    v: Array,
    *,
    kappa: Array,
    a: Array,
    b_y: Array,
    b_v: Array,
    mass: Array,
    dt: float,
    alpha_p: float,
    alpha_i: float,
    alpha_sm: float = 0.0,
    alpha_sm0: float = 0.0,
    alpha_f1: float = 0.0,
    alpha_f2: float = 1.0,
    alpha_f3: float = 0.0,
    leak: float = 0.0,
    jump_limit: float = 4e-4,
    threshold_tau: Array | float = 2.0,
    centres_tau: Array = (0.0, 1.0),
    widths_tau: Array = (0.3, 0.3),
    centres_jump: Array = (0.0, 1.0),
    widths_jump: Array = (0.3, 0.3),
    observer: str = "ts",
    eps: float | None = None,
    history: tuple[Array, Array, Array] | None = None,
) -> dict[str, Array]:
    """One tick for all joints; returns every quantity by name.

    Signals [n]: y rad encoder; b rad estimated encoder fault; e_prev rad last innovation (after the sensor rule);
    history = (q1, q2, u_prev): corrected readings rad of the last two ticks, v + psi rad/s^2 of the last. Without it
    the change of the innovation stands for the jump, which serves only while the innovation is small;
    psi_pi, g, psi_f, v rad/s^2; x [n, N] bank states. kappa [N] or [n, N]; mass [n, n] kg m^2 at q_hat.
    Gains, per tick: alpha_p 1; alpha_i, alpha_f1, alpha_f3 s^-2; alpha_f2 1 (share of the jump that b takes, times
    h_s); alpha_sm rad^.5/s^2; alpha_sm0 rad/s^3; leak 1; jump_limit J rad; threshold_tau N m; eps rad.
    A stage that the observer lacks contributes nothing and keeps its state.
    """
    n = len(y)
    with_sliding = observer in ("eso", "ts")
    with_fuzzy = observer == "ts"
    kappa = np.broadcast_to(kappa, x.shape)

    y_hat = np.array([kappa[j] @ x[j] for j in range(n)])  # Eq. (6)
    e_raw = y - b - y_hat
    jump = e_raw - e_prev
    unexplained = jump
    if history is not None:
        q1, q2, u_prev = history
        unexplained = y - b - 2 * q1 + q2 - dt**2 * u_prev  # what no acceleration explains of the second difference

    # The sensor rule comes first: only an encoder can jump within one sample.
    h_s = sensor_grade(np.abs(unexplained) / jump_limit, centres_jump, widths_jump) if with_fuzzy else np.zeros(n)
    b_next = b + alpha_f2 * h_s * jump
    e = e_raw - alpha_f2 * h_s * jump
    q_hat = y - b_next

    psi_pi_next = psi_pi + alpha_i * e  # Eq. (6), corrected
    if with_sliding:
        psi_sm = alpha_sm * np.sqrt(np.abs(e)) * sign(e, eps) * (1 - h_s) + g  # Eq. (7)
        g_next = g + dt * alpha_sm0 * sign(e, eps)  # Eq. (7), corrected
    else:
        psi_sm, g_next = np.zeros(n), g

    psi = psi_pi + psi_sm + (psi_f if with_fuzzy else 0.0)  # Eq. (15)
    residual_tau = mass @ psi  # Eq. (13), torque channel

    if with_fuzzy:
        h_normal, h_act, h_sensor, h_both = rule_weights(
            np.abs(residual_tau) / threshold_tau,
            np.abs(unexplained) / jump_limit,
            centres_tau,
            widths_tau,
            centres_jump,
            widths_jump,
        )
        psi_f_next = (1 - leak) * psi_f + (h_act * alpha_f1 + h_both * alpha_f3) * e  # Eqs. (8) to (10), corrected
    else:
        h_normal, h_act, h_sensor, h_both = np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n)
        psi_f_next = psi_f

    return {
        "y_hat": y_hat,
        "e_raw": e_raw,
        "jump": jump,
        "h_s": h_s,
        "b_next": b_next,
        "e": e,
        "q_hat": q_hat,
        "psi_pi_next": psi_pi_next,
        "psi_sm": psi_sm,
        "g_next": g_next,
        "psi": psi,
        "residual_tau": residual_tau,
        "h_normal": h_normal,
        "h_act": h_act,
        "h_sensor": h_sensor,
        "h_both": h_both,
        "psi_f_next": psi_f_next,
        "x_next": advance(x, y_hat, e, v, psi, a, b_y, b_v, alpha_p),  # Eq. (6), corrected
        "residual_q": b_next + e,  # Eq. (13), encoder channel: equal to y - y_hat
    }
