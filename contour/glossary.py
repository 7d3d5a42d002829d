"""What figures, flags, kinds and endings mean, in a line each, for reports."""

from __future__ import annotations

from types import MappingProxyType

from contour.contacts import Flag, Kind
from contour.trace import Status

__all__ = ["DEFINITIONS", "FLAGS", "KINDS", "STATUSES", "UNKNOWN", "meaning_of"]

UNKNOWN = ""
"""Meaning of a figure that is not listed."""

_MEANINGS = MappingProxyType(
    {
        "contacts": "Places where the beam touched and was made sense of, flagged ones included.",
        "flagged": "Contacts that say themselves that they must not be trusted; left out of every error here.",
        "pushes_per_contact": "Pushes that one contact took; 1 is the least.",
        "s_error_rms_rel": "Error of s, the distance from the centre of rotation to the contact, root mean square.",
        "s_error_p99_rel": "99 of 100 contacts have a smaller error of s, of s.",
        "point_error_rms_m": "Distance between sensed and true point, root mean square.",
        "point_error_p99_m": "99 of 100 points are nearer to the true one than this.",
        "normal_error_median_rad": "Half of the normals, as sensed, are nearer to the true one in the sensing plane.",
        "normal_error_p95_rad": "95 of 100 normals, as sensed, are nearer to the true one in the sensing plane.",
        "smooth_normal_error_median_rad": "Half of the normals, smoothed along contours, are nearer to the true one.",
        "smooth_normal_error_p95_rad": "95 of 100 normals, smoothed along the contours, are nearer to the true one.",
        "coverage_95": "How often the true s lies in the 95 % interval claimed; 95 % is honest, less is too bold.",
        "coverage_95_normal": "How often the true normal, in the sensing plane, lies in the 95 % interval claimed.",
        "silently_wrong": "Unflagged contacts that are far off all the same; every one is a fault.",
        "rays_cast": "Rays that the simulation cast at the mesh.",
        "scan_s": "Time that the computer took; in simulation it has nothing to do with the machine's.",
        "contacts_per_s": "Contacts that the computer made in a second.",
        "machine_time_s": "Time that the machine takes, moves included, one contour after the other.",
        "unconverged": "Pushes whose simulation did not reach its tolerance.",
        "rungs.edge": "Pushes simulated as a beam on an edge.",
        "rungs.reduced": "Pushes simulated with the reduced rod on a round surface.",
        "rungs.profile": "Pushes simulated with the reduced rod on the mesh's own profile.",
        "rungs.elastica": "Pushes simulated with the geometrically exact rod.",
        "surface.method": "How the surface was made.",
        "surface.vertices": "Vertices of the surface.",
        "surface.faces": "Triangles of the surface.",
        "surface.watertight": "Whether every edge of the surface has two faces.",
        "surface.touched": "Share of the surface's area near a contact; the rest is a guess.",
        "surface.seconds": "Processor time that the surface took.",
        "surface.notes": "What the surface could not do.",
    }
)

_PARTS = (
    ("accuracy_mean", "Mean distance from the surface made to the nominal one: how right is what was made."),
    ("accuracy_rms", "Distance from the surface made to the nominal one, root mean square."),
    ("accuracy_hausdorff", "95 % of the surface made are nearer to the nominal one than this."),
    ("accuracy_max", "The place of the surface made that is farthest from the nominal one."),
    (
        "completeness_mean",
        "Mean distance from the nominal surface, where a beam can reach it, to the one made.",
    ),
    ("completeness_rms", "Distance from the reachable nominal surface to the one made, root mean square."),
    ("completeness_hausdorff", "95 % of the reachable nominal surface are nearer to the one made than this."),
    ("completeness_max", "The reachable place of the nominal surface that is farthest from the one made."),
    (
        "f_score",
        "How much of both surfaces lies within 1 mm of the other: 1 is all (harmonic mean of both shares).",
    ),
    (
        "normal_angle_median",
        "Half of the surface made faces nearer to where the nominal one faces than this.",
    ),
    ("normal_angle_p95", "95 % of the surface made face nearer to where the nominal one faces than this."),
    ("reachable", "Share of the nominal surface that a straight beam from the gantry's side can reach."),
    ("within_5mm", "Share of the reachable nominal surface that has a contact on its own side within 5 mm."),
    ("compare_s", "Processor time that the comparison took."),
    ("mesh", "The nominal mesh."),
    ("notes", "What to know before believing the comparison."),
)
"""Beginnings of the names within a comparison."""

FLAGS = MappingProxyType(
    {
        Flag.SLIP_OFF: "A push slid off the body, and no other push made up for it.",
        Flag.UNRESOLVED: "The tolerance was not reached, or the samples contradict the model.",
        Flag.OVER_MOMENT: "The moment limit left too little of the push to measure.",
        Flag.LOST: "The push felt nothing: the body was not where the touch had been.",
        Flag.SOFT_OR_TIP: "A soft body nearby and the beam's end cannot be told apart.",
    }
)
"""Why a contact is flagged."""

KINDS = MappingProxyType(
    {
        Kind.SIDE: "the beam's side lies on a smooth surface",
        Kind.EDGE: "the beam's side lies on an edge or corner",
        Kind.TIP: "the beam's end touches; its normal is known in the sensing plane only",
        Kind.LINE: "the beam lies along a straight side; the end nearest its base is what is sensed",
    }
)
"""What the beam touched."""

STATUSES = MappingProxyType(
    {
        Status.WAITING: "never started",
        Status.SEARCHING: "broke off while looking for the object",
        Status.FOLLOWING: "broke off on its way",
        Status.RETURNING: "broke off on its way back to go the other way round",
        Status.CLOSED: "came back to where it began",
        Status.ENDED: "was followed both ways until it could not go on",
        Status.LOST: "found nothing where the outline should go on, or no contact at all",
        Status.DUPLICATE: "met an outline that another contour had followed",
    }
)
"""How a contour ended."""

DEFINITIONS = (
    (
        "Coverage",
        (
            "The share of unflagged contacts whose true value lies within 1.96 claimed sigmas. Sigmas are honest at "
            "95 %. Much below, they are too small and claim too much; at 99 % and above they waste knowledge."
        ),
    ),
    (
        "Silently wrong",
        (
            "An unflagged contact whose error of s exceeds both 4 of its sigmas and 1 % of the beam's length, or whose "
            "error of the normal exceeds both 4 of its sigmas and 5 deg. It says it can be trusted, and cannot."
        ),
    ),
    ("Sigma", "One standard deviation of what a contact claims to know, the model's own error included."),
    (
        "s",
        (
            "Distance from the antenna's centre of rotation to the contact along the undeformed beam. It is what two "
            "moments and two angles tell; errors of points come from it."
        ),
    ),
    (
        "Sensing plane",
        (
            "The plane square to the undeformed beam. Normals are sensed in it; on a smooth side that is the whole "
            "normal, at the beam's tip only its part in the plane."
        ),
    ),
    (
        "Not touched",
        (
            "Surface farther than a tenth of the longest edge of the points from any contact on the same side of the "
            "body. It is a smooth guess, drawn in grey stripes, however good it looks."
        ),
    ),
    (
        "Signed deviation",
        "Distance from the nominal surface: plus is outside of it (too much), minus inside (too little).",
    ),
)
"""Terms and what they mean."""


def meaning_of(key: str) -> str:
    """What a figure of ``metrics.json`` means; UNKNOWN if it is not listed. Parts are ``whole.part``.

    >>> meaning_of("silently_wrong")
    'Unflagged contacts that are far off all the same; every one is a fault.'
    """
    if key in _MEANINGS:
        return _MEANINGS[key]
    whole, _, part = key.partition(".")
    if whole in {"comparison", "compared"}:
        return next((text for beginning, text in _PARTS if part.startswith(beginning)), UNKNOWN)
    return UNKNOWN
