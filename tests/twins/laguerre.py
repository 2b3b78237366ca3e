"""Laguerre banks and the ARX-Laguerre predictor, Eqs. (4) and (5)."""

import numpy as np
from scipy.signal import lfilter

Array = np.ndarray


def bank_matrices(xi: float, order: int) -> tuple[Array, Array]:
    """State matrices of one bank, Eq. (5): x(k+1) = A x(k) + b u(k), with A [order, order] and b [order], unitless.

    The pole xi lies in (-1, 1). A row i sees every state before it, because stage i filters stage i - 1.
    """
    a = np.zeros((order, order))
    b = np.zeros(order)
    for i in range(order):
        b[i] = np.sqrt(1 - xi**2) * (-xi) ** i
        a[i, i] = xi
        for j in range(i):
            a[i, j] = (1 - xi**2) * (-xi) ** (i - j - 1)
    return a, b


def functions(xi: float, order: int, length: int) -> Array:
    """Laguerre functions of Eq. (4), [length, order]: impulse responses of a low pass followed by i all passes.

    L_i(z) = sqrt(1 - xi^2) / (z - xi) * ((1 - xi z) / (z - xi))^i. Row 0 is zero: every L_i delays by one sample.
    """
    impulse = np.zeros(length)
    impulse[0] = 1.0
    stage = lfilter([0.0, np.sqrt(1 - xi**2)], [1.0, -xi], impulse)
    columns = []
    for _ in range(order):
        columns.append(stage)
        stage = lfilter([-xi, 1.0], [1.0, -xi], stage)
    return np.stack(columns, axis=1)


def filtered(xi: float, order: int, u: Array) -> Array:
    """Bank outputs x_n = l_n * u of Eq. (4) for a signal u [length], as a direct convolution sum: [length, order]."""
    length = len(u)
    response = functions(xi, order, length)
    x = np.zeros((length, order))
    for k in range(length):
        for m in range(k + 1):
            x[k] += response[k - m] * u[m]
    return x


def predict(kappa: Array, x_a: Array, x_b: Array) -> float | Array:
    """Model output y = kappa^T [x_a; x_b] of Eq. (5), rad: x_a [N_a] or [n, N_a], x_b alike, kappa [N_a + N_b]."""
    return np.concatenate([x_a, x_b], axis=-1) @ kappa


def block(xi_a: float, order_a: int, xi_b: float, order_b: int) -> tuple[Array, Array, Array]:
    """Both banks side by side, Eq. (5): A [N, N], entry of the output b_y [N], entry of the input b_v [N].

    N = order_a + order_b; x(k+1) = A x(k) + b_y y(k) + b_v v(k).
    """
    a_a, b_a = bank_matrices(xi_a, order_a)
    a_b, b_b = bank_matrices(xi_b, order_b)
    a = np.zeros((order_a + order_b, order_a + order_b))
    a[:order_a, :order_a] = a_a
    a[order_a:, order_a:] = a_b
    b_y = np.concatenate([b_a, np.zeros(order_b)])
    b_v = np.concatenate([np.zeros(order_a), b_b])
    return a, b_y, b_v


def rest_state(a: Array, b_y: Array, q: Array) -> Array:
    """Bank state [n, N] of joints that have always stood at q [n] rad with no input: x = A x + b_y q."""
    unit = np.linalg.solve(np.eye(len(b_y)) - a, b_y)
    return np.outer(q, unit)


def exact_kappa(xi: float, dt: float) -> Array:
    """Coefficients [5] that make the predictor exact for a rigid joint, N_a = 3, N_b = 2, xi_a = xi_b = xi, T = dt s.

    The joint is qd(k+1) = qd(k) + T v(k), q(k+1) = q(k) + T qd(k+1), that is (z - 1)^2 q = T^2 z v. It holds that
    q = H_y q + H_v v with 1 - H_y = (z - 1)^2/(z - xi)^2 and H_v = T^2 z/(z - xi)^2. On the basis
    c/(z - xi), c (1 - xi z)/(z - xi)^2, c = sqrt(1 - xi^2), the numerators give per bank
        c (k_0 - xi k_1) = coefficient of z,   c (k_1 - xi k_0) = constant term,
    and the third output coefficient is zero: two stages span H_y already.
    """
    c = np.sqrt(1 - xi**2)
    basis = c * np.array([[1.0, -xi], [-xi, 1.0]])
    k_y = np.linalg.solve(basis, [2 * (1 - xi), xi**2 - 1])
    k_v = np.linalg.solve(basis, [dt**2, 0.0])
    return np.concatenate([k_y, [0.0], k_v])


def error_matrix(
    a: Array,
    b_y: Array,
    b_v: Array,
    kappa: Array,
    alpha_p: float,
    alpha_i: float,
    alpha_f: float = 0.0,
    leak: float = 0.0,
) -> Array:
    """Error dynamics of the linear observer, Eqs. (6), (8) corrected, for (x - x_hat, psi_PI, psi_F): [N + 2, N + 2].

    x - x_hat obeys A + (1 - alpha_p) b_y kappa^T, the two fault states enter through -b_v and integrate the innovation,
    psi_F with a leak. Spectral radius < 1 is the stability check. With alpha_f = 0 and leak > 0 it is the PI observer.
    """
    order = len(kappa)
    m = np.zeros((order + 2, order + 2))
    m[:order, :order] = a + (1 - alpha_p) * np.outer(b_y, kappa)
    m[:order, order] = -b_v
    m[:order, order + 1] = -b_v
    m[order, :order] = alpha_i * kappa
    m[order, order] = 1.0
    m[order + 1, :order] = alpha_f * kappa
    m[order + 1, order + 1] = 1.0 - leak
    return m


def spectral_radius(matrix: Array) -> float:
    """Largest modulus of the eigenvalues."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())
