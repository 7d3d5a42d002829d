"""exact"""
from contour.contact import _rows, LEAST_ANGLE, refine, SHARPEST
import numpy as np
from contour.slip import ArcProfile, follow
from contour.rod import follow_rod
from types import SimpleNamespace
def push_cycle(eps, thetas, *, distance, friction, radius_along, radius_across, steps=8):
    angles, scale, (eps_row, mu, along, across) = _rows(eps, thetas, distance, friction, radius_along, radius_across)
    shape = angles.shape
    angles = np.maximum(angles.reshape(-1, shape[-1]).T, 1e-4)
    path_angles, wanted = refine(angles, steps)
    profile = ArcProfile(1.0 / np.where(np.abs(across)<SHARPEST, SHARPEST, across))
    red = follow(eps_row, path_angles, mu, profile)
    p = follow_rod(eps_row, path_angles, mu, along, profile, red)
    tk=lambda v: v[wanted].T.reshape(shape)
    return SimpleNamespace(delta=tk(p.delta), moment_angle=tk(p.moment_angle), slide=tk(p.slide)*scale[...,None], arc_length=tk(p.arc_length)*scale[...,None], slipped_off=tk(p.slipped_off), converged=tk(p.converged))
def push_response(eps, theta, **k):
    c=push_cycle(eps, np.asarray(theta)[...,None], **k)
    return SimpleNamespace(delta=c.delta[...,0],compliance_ratio=theta/c.moment_angle[...,0],slide=c.slide[...,0],arc_length=c.arc_length[...,0],slipped_off=c.slipped_off[...,0],converged=c.converged[...,0])
