"""Serial arms of any number of hinges, as MJCF text."""

from __future__ import annotations

LINK, RADIUS, DENSITY = 0.3, 0.04, 1200  # m, m, kg/m^3


def serial(n: int) -> str:
    """An arm of n hinges about z and y in turn, each with a motor, damping and a motor's inertia."""
    links, motors = "", ""
    for i in range(n):
        axis, limit = ("0 1 0" if i % 2 else "0 0 1"), 40.0 * (n - i)
        links += (
            f'<body name="link{i + 1}" pos="{LINK if i else 0} 0 0"><joint name="joint{i + 1}" axis="{axis}" armature="0.1" '
            f'damping="1"/><geom type="capsule" size="{RADIUS}" fromto="0 0 0 {LINK} 0 0" density="{DENSITY}"/>'
        )
        motors += f'<motor joint="joint{i + 1}" ctrllimited="true" ctrlrange="-{limit} {limit}"/>'
    return (
        f'<mujoco model="arm{n}"><compiler angle="radian"/><worldbody>{links}<site name="tool" pos="{LINK} 0 0"/>'
        f"{'</body>' * n}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
