"""Reads meshes and point files with trimesh, as other programs do; prints what it found as JSON.

    check_meshes.py FILE...
"""

import json
import os
import sys

import numpy as np
import trimesh

out = {}
for path in sys.argv[1:]:
    read = trimesh.load(path, process=False)
    if isinstance(read, trimesh.Scene):
        (read,) = read.geometry.values()
    said = {"points": len(read.vertices)}
    if isinstance(read, trimesh.Trimesh):
        # STL has no shared vertices: joined where they coincide.
        joined = trimesh.Trimesh(read.vertices, read.faces, process=True)
        joined.merge_vertices(merge_tex=True, merge_norm=True)
        said |= {
            "triangles": len(read.faces),
            "watertight": bool(joined.is_watertight),
            "winding": bool(joined.is_winding_consistent),
            "euler": int(joined.euler_number),
            "volume": float(joined.volume),
        }
        if path.endswith((".ply", ".glb")):
            normals = np.asarray(read.vertex_normals)
            corners = read.faces[:, 0]
            said["normals_agree"] = float((normals[corners] * read.face_normals).sum(1).min())
    raw = read.metadata.get("_ply_raw")
    if raw:
        said["properties"] = list(raw["vertex"]["properties"])
    out[os.path.basename(path)] = said
print(json.dumps(out))
