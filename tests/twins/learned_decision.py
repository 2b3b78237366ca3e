"""What the learned decision remembers, is shown and says, one joint and one moment after the other."""

import math

import numpy as np

FAST, MEDIUM, SLOW, PEAK, SOON, RETURN = 0.03, 0.1, 0.3, 0.4, 0.06, 0.3  # s
REMEMBERED = 7


def size(x: float) -> float:
    return math.log1p(min(abs(x), 30))


class Twin:
    """Memory of n joints that are looked at every dt s."""

    def __init__(self, n: int, dt: float, jump: np.ndarray, alpha_q: np.ndarray) -> None:
        self.n, self.dt, self.jump, self.alpha_q = n, dt, jump, alpha_q
        self.fast, self.slow = np.zeros((2, n, REMEMBERED))
        self.peak, self.side, self.own, self.since = np.zeros((n, 3)), np.zeros(n), np.zeros(n), 0.0
        self.up, self.rises = np.zeros((2, n)), np.zeros((2, n))

    def look(self, x: dict[str, np.ndarray]) -> np.ndarray:
        """What is shown [inputs, n] of the signals of a moment [n] by name."""
        now = np.array([self._now(x, j) for j in range(self.n)])
        for means, time in ((self.fast, FAST), (self.slow, SLOW)):
            means += (1 - math.exp(-self.dt / time)) * (now - means)
        self.peak = np.maximum(now[:, :3], math.exp(-self.dt / PEAK) * self.peak)
        up = now[:, 3:6].sum(1) > 0
        self.own = np.where(up, self.own + self.dt, 0)
        self.since = self.since + self.dt if up.any() else 0.0
        up = np.array([now[:, 5], np.maximum(now[:, 3], now[:, 4])])
        self.rises = math.exp(-self.dt / SLOW) * self.rises + np.maximum(up - self.up, 0)
        self.up = up
        shown, residual = [], np.array([size(r) for r in x["residual"] / x["threshold"]])
        for j in range(self.n):
            ratio = x["tau"][j] / x["threshold"][j]
            self.side[j] += (1 - math.exp(-self.dt / MEDIUM)) * (math.copysign(now[j, 0], ratio) - self.side[j])
            alone = [
                residual[j],
                min(x["jumps"][j] / 8, 4),
                min(abs(x["one_way"][j]) / 8, 4),
                x["equal"][j] / (x["equal"][j] + 5) * min(x["travel"][j] / self.jump[j], 1),
                size(x["travel"][j] / self.jump[j]),
                min(x["turns"][j] / 6, 2),
                size(x["peak"][j] / x["threshold"][j]),
                x["age"][j] / (x["age"][j] + SOON),
                abs(self.side[j]),
                self.since / (self.since + SOON),
                self.own[j] / (self.own[j] + SOON),
                *self.rises[:, j],
            ]
            rest = [k for k in range(self.n) if k != j]
            compared = [
                now[:, 0],
                residual,
                self.peak[:, 0],
                self.peak[:, 2],
                self.slow[:, 4],
                self.slow[:, 3],
                self.fast[:, 1],
            ]
            others = [max(float(signal[k]) for k in rest) for signal in compared]
            shown.append([*now[j], *self.fast[j], *self.slow[j], *self.peak[j], *alone, *others])
        return np.array(shown).T

    def _now(self, x: dict[str, np.ndarray], j: int) -> list[float]:
        return [
            size(x["tau"][j] / x["threshold"][j]),
            size(x["e"][j] / self.jump[j]),
            size(x["q"][j] / self.alpha_q[j]),
            x["up_q"][j],
            x["suspect"][j],
            x["up_tau"][j],
            min(abs(x["residual"][j]) / x["peak"][j], 1) if x["peak"][j] > 0 else 0.0,
        ]


class Speaker:
    """What is made of the answers: averages of a fault's later ones, and its name in the gaps."""

    def __init__(self, n: int, dt: float, doubt: float, release: int, certain: float) -> None:
        self.dt, self.doubt, self.release, self.certain, self.odds = dt, doubt, release, certain, np.zeros((2, n))
        self.k, self.looks, self.speaks = -1, -1, None
        self.alarms: list[int] = []
        self.joints: set[int] = set()

    def say(self, rule: np.ndarray, look: float, odds: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Verdict [n] of a tick, and where it is a guess [n].

        Of the rule's verdict [n], s from one look to the next or 0 without one, and log odds [2, n].
        """
        self.k += 1
        joints = set(np.flatnonzero(rule))
        quiet = self.k - self.alarms[-1] - 1 if self.alarms else 0  # ticks before this one
        late = quiet * self.dt > RETURN + 1e-9 or ((quiet + 1) * self.dt > RETURN + 1e-9 and not joints)
        if late or (joints and quiet and not joints & self.joints):
            self.alarms, self.joints, self.speaks = [], set(), None
        if joints:
            self.alarms.append(self.k)
            self.joints |= joints
        gaps = [b - a - 1 for a, b in zip(self.alarms, self.alarms[1:], strict=False)]
        gap = max([g for g in gaps if g >= self.release], default=0)
        self.looks += look > 0
        young = bool(self.alarms) and (self.k - self.alarms[0]) * self.dt < 0.1 - 1e-9
        between = 2 if young else 4  # looks
        if look and joints and self.looks % between == 0:
            back, since = min(0.4 * ((self.k - self.alarms[0]) * self.dt - 0.05), 0.1), between * look
            self.odds += (1.0 if back <= 0 else 1 - math.exp(-since / back)) * (np.clip(odds, -6, 6) - self.odds)
            sure = gap > 0 or (abs(self.odds) >= self.doubt).all()
            self.speaks = bool(sure and (self.odds > 0).any())
        quiet = self.k - self.alarms[-1] if self.alarms else math.inf
        verdict, held = rule, joints or quiet <= min(1.5 * gap, 0.15 / self.dt)
        if self.speaks and held:
            verdict = (self.odds[0] > 0) + 2 * (self.odds[1] > 0)
        guess = (abs(self.odds) < self.certain).any(0) | ((self.speaks is False) & (verdict > 0))
        return verdict, guess & (self.speaks is not None and bool(held) and bool((verdict > 0).any()))


def answer(weights: dict[str, np.ndarray], shown: np.ndarray) -> np.ndarray:
    """Log odds [2, n] of what is shown [inputs, n]."""
    made = []
    for column in shown.T:
        x = (column - weights["centre"]) / weights["width"]
        for layer in ("first", "second"):
            x = np.maximum(x @ weights[layer] + weights[f"{layer}_bias"], 0)
        made.append(x @ weights["last"] + weights["last_bias"])
    return np.array(made).T
