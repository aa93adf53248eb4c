"""Opens a STEP file in OpenCASCADE and holds it against the surface file it was written beside.

    check_step.py SURFACE.json SURFACE.step

Prints one JSON object. Exits with 1, saying why, unless the shape is valid, watertight where the surface is closed,
of the same topology, and on the patches: volume to 1e-9 relative (exact integral over the patches against
OpenCASCADE's), points to 1e-9 of the size. Reads the surface file with numpy alone.
"""

import json
import math
import sys
import time

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepCheck import BRepCheck_Analyzer
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.BRepGProp import BRepGProp
from OCP.GProp import GProp_GProps
from OCP.gp import gp_Pnt
from OCP.IFSelect import IFSelect_RetDone
from OCP.STEPControl import STEPControl_Reader
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FACE, TopAbs_IN, TopAbs_OUT, TopAbs_SHELL, TopAbs_SOLID, TopAbs_VERTEX
from OCP.TopExp import TopExp, TopExp_Explorer
from OCP.TopTools import TopTools_IndexedDataMapOfShapeListOfShape, TopTools_IndexedMapOfShape
from OCP.TopoDS import TopoDS

failures = []


def must(condition, what):
    if not condition:
        failures.append(what)


class Patches:
    """The patches of a surface file, evaluated by their Bernstein sum."""

    def __init__(self, path):
        data = json.load(open(path))
        self.exponents = np.array(data["exponents"])
        self.degree = data["degree"]
        self.points = np.array([f["control_points"] for f in data["faces"]])
        self.faces = np.array([f["vertices"] for f in data["faces"]])
        self.borders = data["borders"]
        fact = [math.factorial(k) for k in range(self.degree + 1)]
        self.weight = np.array([fact[self.degree] / (fact[i] * fact[j] * fact[k]) for i, j, k in self.exponents])

    def basis(self, b):
        """(places, control points), for barycentric coordinates b of shape (places, 3)."""
        return self.weight * np.prod(b[:, None, :] ** self.exponents[None], axis=2)

    def derivatives(self, b):
        """Bases of the derivatives by the second and the third barycentric coordinate."""
        out = []
        for axis in (1, 2):
            total = 0
            for m, sign in ((axis, 1), (0, -1)):
                lower = self.exponents.copy()
                factor = lower[:, m].astype(float)
                lower[:, m] = np.maximum(lower[:, m] - 1, 0)
                total = total + sign * self.weight * factor * np.prod(b[:, None, :] ** lower[None], axis=2)
            out.append(total)
        return out

    def at(self, b):
        return np.einsum("pk,fkd->fpd", self.basis(b), self.points)

    def volume_and_area(self):
        """Exact volume (polynomials of degree 13) and area by quadrature on each triangle."""
        x, w = np.polynomial.legendre.leggauss(24)
        x, w = (x + 1) / 2, w / 2
        s, t = np.meshgrid(x, x, indexing="ij")
        b = np.stack([1 - s, s * (1 - t), s * t], -1).reshape(-1, 3)
        weight = (np.outer(w, w) * s).ravel()
        du, dv = (np.einsum("pk,fkd->fpd", d, self.points) for d in self.derivatives(b))
        cross = np.cross(du, dv)
        volume = (np.einsum("fpd,fpd->fp", self.at(b), cross) @ weight).sum() / 3
        return volume, (np.linalg.norm(cross, axis=2) @ weight).sum()

    def topology(self):
        edges = {tuple(sorted((f[k], f[(k + 1) % 3]))) for f in self.faces for k in range(3)}
        return len(np.unique(self.faces)) - len(edges) + len(self.faces)


def count(shape, kind):
    shapes = TopTools_IndexedMapOfShape()
    TopExp.MapShapes_s(shape, kind, shapes)
    return shapes.Extent()


surface = Patches(sys.argv[1])
started = time.perf_counter()
reader = STEPControl_Reader()
must(reader.ReadFile(sys.argv[2]) == IFSelect_RetDone, "the reader refuses the file")
reader.TransferRoots()
shape = reader.OneShape()
seconds = time.perf_counter() - started

must(BRepCheck_Analyzer(shape).IsValid(), "BRepCheck finds the shape invalid")
edges = TopTools_IndexedDataMapOfShapeListOfShape()
TopExp.MapShapesAndAncestors_s(shape, TopAbs_EDGE, TopAbs_FACE, edges)
uses = [edges.FindFromIndex(k).Size() for k in range(1, edges.Extent() + 1)]
free = uses.count(1)
must(max(uses) <= 2, "an edge has more than two faces")
faces, vertices = count(shape, TopAbs_FACE), count(shape, TopAbs_VERTEX)
euler = vertices - len(uses) + faces
must(euler == surface.topology(), f"euler characteristic {euler}, the patches have {surface.topology()}")
must(faces >= len(surface.faces), f"{faces} faces of {len(surface.faces)} patches")

properties = GProp_GProps()
volume, area = surface.volume_and_area()
if surface.borders:
    must(free > 0 and count(shape, TopAbs_SOLID) == 0, "an open surface has become closed")
    volume_error = None
else:
    must(free == 0, f"{free} free edges")
    must(count(shape, TopAbs_SOLID) == count(shape, TopAbs_SHELL) > 0, "not every shell is a solid")
    # On faces, not on the solid: with a tolerance the adaptive integration reaches rounding.
    BRepGProp.VolumeProperties_s(shape, properties, 1e-12, True, False)
    volume_error = abs(properties.Mass() / volume - 1)
    must(volume_error < 1e-9, f"volume {properties.Mass()!r}, the patches' is {volume!r}")
BRepGProp.SurfaceProperties_s(shape, properties, 1e-9)
area_error = abs(properties.Mass() / area - 1)
must(area_error < 1e-6, f"area {properties.Mass()!r}, the patches' is {area!r}")

# Points of the patches, inside and on edges, to the shape.
size = np.ptp(surface.points.reshape(-1, 3), axis=0).max()
rng = np.random.default_rng(1)
b = np.concatenate([rng.dirichlet([1, 1, 1], 3), [[0.3, 0.7, 0], [0, 0.5, 0.5]]])
places = surface.at(b).reshape(-1, 3)
places = places[rng.permutation(len(places))[:120]]
worst = 0.0
for place in places:
    vertex = BRepBuilderAPI_MakeVertex(gp_Pnt(*map(float, place))).Vertex()
    worst = max(worst, BRepExtrema_DistShapeShape(vertex, shape).Value())
must(worst < 1e-9 * size, f"a point of the patches is {worst} away")

tolerance = 0.0
explorer = TopExp_Explorer(shape, TopAbs_EDGE)
while explorer.More():
    edge = TopoDS.Edge_s(explorer.Current()) if hasattr(TopoDS, "Edge_s") else TopoDS.Edge(explorer.Current())
    tolerance = max(tolerance, BRep_Tool.Tolerance_s(edge))
    explorer.Next()

print(json.dumps({
    "faces": faces, "edges": len(uses), "vertices": vertices, "free_edges": free, "euler": euler,
    "volume_error": volume_error, "area_error": area_error, "point_error": worst / size,
    "tolerance": tolerance, "seconds": round(seconds, 3), "failures": failures,
}))
sys.exit(bool(failures))
