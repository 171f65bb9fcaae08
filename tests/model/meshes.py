"""Meshes of a scene's geoms."""

import mujoco
import numpy as np


def vertices(model, word):
    """Returns the vertices of all meshes whose names begin with `word`, in the map frame."""
    found = [np.zeros((0, 3))]
    for i in range(model.ngeom):
        geom = model.geom(i)
        if geom.name.startswith(word):
            mesh = int(geom.dataid[0])
            first = model.mesh_vertadr[mesh]
            rotation = np.empty(9)
            mujoco.mju_quat2Mat(rotation, geom.quat)
            local = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
            found.append(local @ rotation.reshape(3, 3).T + geom.pos)
    return np.concatenate(found)
