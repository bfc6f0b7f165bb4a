"""Whether somebody is hidden from the VUT by somebody else."""

from __future__ import annotations

from ssp_core.motion.state import ObjectState


def is_hidden(vut: ObjectState, subject: ObjectState, occluder: ObjectState, eye_m: float) -> bool:
    """No corner of an object can be seen past an occluder from a place on the VUT's centre line.

    Args:
        vut: the one that looks.
        subject: who is to be hidden.
        occluder: who hides.
        eye_m: the camera's place ahead of the VUT's reference point.
    """
    eye = vut.pose.to_parent(eye_m, 0.0)
    corners = occluder.box.corners()
    sides = [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    return all(any(_cross(eye, point, a, b) for a, b in sides) for point in subject.box.corners())


def _cross(
    p: tuple[float, float],
    q: tuple[float, float],
    a: tuple[float, float],
    b: tuple[float, float],
) -> bool:
    """Two segments cross."""

    def side(u: tuple[float, float], v: tuple[float, float], w: tuple[float, float]) -> float:
        return (v[0] - u[0]) * (w[1] - u[1]) - (v[1] - u[1]) * (w[0] - u[0])

    return side(p, q, a) * side(p, q, b) < 0.0 and side(a, b, p) * side(a, b, q) < 0.0
