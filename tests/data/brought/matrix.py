"""Brings surfaces and wells of other programs into images, in every way in which they are written.

A fault (strike 20, dip 60 degrees), a horizon (dip 10 degrees) and a well are written in each format, in the
units, signs, orders, separators and null values that users have, by the programs that write such files where
they can be had (xtgeo, VTK, lasio, resqpy, pandas) and as text otherwise. An independent reader reads each file
and finds the object; then atomesh meshes an image with the file, and its faces or fixed nodes must lie on
the object.

    matrix.py ATOMESH FOLDER [--only FORMAT,...]
    matrix.py ATOMESH FOLDER --keep FILES     also copies the first files of each format that are right to FILES,
                                              with `cases.json`, for `cargo test --test main brought::`

The combinations are generated: each pair of values of two dimensions occurs at least once among those that a format can hold.
A combination is right, wrong (another place or another name, without a word), or refused (exit code 1).
The program prints a table and fails if any is wrong, or more than one in ten is refused.
"""

import argparse
import itertools
import json
import math
import os
import re
import shutil
import subprocess
import sys

import numpy as np

FOOT = 0.3048
VELOCITY = 2500.0
# The image: 32 x 28 x 24 samples.
DIMS = (32, 28, 24)
ORIGIN = (450000.0, 6780000.0)
STEP = (25.0, 25.0, 12.0)
TOP = 1000.0  # depth of the first sample, in metres
EXTENT = [(n - 1) * s for n, s in zip(DIMS, STEP)]
CENTRE = (ORIGIN[0] + EXTENT[0] / 2, ORIGIN[1] + EXTENT[1] / 2, -(TOP + EXTENT[2] / 2))

# The images: where the samples lie. Each has its options, and maps heights in metres to z of the image.
IMAGES = {
    "up": (["--spacing", "25,25,12", "--origin", "450000,6780000,-1276", "--unit", "m"], lambda z: z),
    "depth": (["--spacing", "25,25,12", "--origin", "450000,6780000,-1000", "--unit", "m", "--axes", "x,y,depth"],
              lambda z: z),
    "feet": (["--spacing", f"{25 / FOOT},{25 / FOOT},{12 / FOOT}", "--origin",
              f"{450000 / FOOT},{6780000 / FOOT},{-1276 / FOOT}", "--unit", "ft"], lambda z: z / FOOT),
    "mixed": (["--spacing", f"25,25,{12 / FOOT}", "--origin", f"450000,6780000,{-1276 / FOOT}", "--unit", "m,m,ft"],
              lambda z: z / FOOT),
    # 12 m at 2,500 m/s are 9.6 ms of two-way time.
    "time": (["--spacing", "25,25,9.6", "--origin", "450000,6780000,-800", "--unit", "m,m,ms", "--axes", "x,y,time"],
             lambda z: z * 2000 / VELOCITY),
    "converted": (["--spacing", "25,25,9.6", "--origin", "450000,6780000,-800", "--unit", "m,m,ms", "--axes", "x,y,time",
                   "--velocity", str(VELOCITY)], lambda z: z),
}


def in_xy(image):
    """Factor from metres to the image's unit of x and y."""
    return 1 / FOOT if image == "feet" else 1.0


class Plane:
    """A plane through the centre of the image, by strike and dip in degrees (right-hand rule)."""

    def __init__(self, name, strike, dip, is_horizon):
        self.name, self.is_horizon = name, is_horizon
        s, d = math.radians(strike), math.radians(dip)
        # Along strike, and down the dip to the right of it; x is east, y is north, z is up.
        self.along = np.array([math.sin(s), math.cos(s), 0.0])
        self.down = np.array([math.cos(s) * math.cos(d), -math.sin(s) * math.cos(d), -math.sin(d)])
        self.normal = np.cross(self.along, self.down)
        self.normal /= np.linalg.norm(self.normal)

    def distance(self, points):
        return (np.asarray(points) - CENTRE) @ self.normal

    def height(self, x, y):
        n = self.normal
        return CENTRE[2] - (n[0] * (x - CENTRE[0]) + n[1] * (y - CENTRE[1])) / n[2]

    def grid(self, nu, nv):
        """Points on the plane, rows down the dip, a little beyond the image."""
        if self.is_horizon:
            x = np.linspace(ORIGIN[0] - 20, ORIGIN[0] + EXTENT[0] + 20, nu)
            y = np.linspace(ORIGIN[1] - 20, ORIGIN[1] + EXTENT[1] + 20, nv)
            return np.array([[(a, b, self.height(a, b)) for b in y] for a in x])
        z = np.linspace(-TOP + 5, -TOP - EXTENT[2] - 5, nv)
        u = np.linspace(-420, 420, nu)
        rows = []
        for a in u:
            row = []
            for h in z:
                t = (h - CENTRE[2]) / self.down[2]
                row.append(np.array(CENTRE) + a * self.along + t * self.down)
            rows.append(row)
        return np.array(rows)


FAULT = Plane("Fault 7", 20, 60, False)
HORIZON = Plane("Top Sand", 65, 10, True)


def triangles_of(grid):
    nu, nv = grid.shape[:2]
    index = lambda i, j: i * nv + j
    out = []
    for i in range(nu - 1):
        for j in range(nv - 1):
            out += [(index(i, j), index(i + 1, j), index(i + 1, j + 1)), (index(i, j), index(i + 1, j + 1), index(i, j + 1))]
    return out


# ------------------------------------------------------------------ values in a file

class Frame:
    """How a file writes positions: its units of x, y and of z, and the sign of z."""

    def __init__(self, case):
        self.xy = 1 / FOOT if case["unit"] == "ft-all" else 1.0
        self.z = {"m": 1.0, "ft": 1 / FOOT, "ft-all": 1 / FOOT, "km": 1e-3,
                  "ms": 2000 / VELOCITY, "s": 2 / VELOCITY}[case["unit"]]
        self.sign = -1.0 if case["sign"] == "down" else 1.0

    def write(self, points):
        p = np.array(points, float).reshape(-1, 3).copy()
        p[:, :2] *= self.xy
        p[:, 2] *= self.z * self.sign
        return p

    def read(self, points):
        p = np.array(points, float).reshape(-1, 3).copy()
        p[:, :2] /= self.xy
        p[:, 2] /= self.z * self.sign
        return p


UNIT_NAME = {"m": ("m", "m"), "ft": ("m", "ft"), "ft-all": ("ft", "ft"), "km": ("m", "km"), "ms": ("m", "ms"), "s": ("m", "s")}


def suffix(case, states_unit, states_sign, default_unit=None):
    """What the user must add because the file does not say it."""
    xy, z = UNIT_NAME[case["unit"]]
    text = ""
    if not states_unit and (xy, z) != image_units(case["image"]):
        text += f",unit={xy},{xy},{z}" if xy != image_units(case["image"])[0] else f",unit={z}"
    return text


def image_units(image):
    return {"up": ("m", "m"), "depth": ("m", "m"), "feet": ("ft", "ft"), "mixed": ("m", "ft"), "time": ("m", "ms"),
            "converted": ("m", "m")}[image]


def with_nulls(points, null):
    """Points with rows of a null value between them, far from their neighbours."""
    if null == "none":
        return points, np.zeros(len(points), bool)
    value = float(null)
    rows, dead = [], []
    for i, p in enumerate(points):
        rows.append(p)
        dead.append(False)
        if i % 7 == 3:
            rows.append(np.array([p[0], p[1], value]))
            dead.append(True)
    return np.array(rows), np.array(dead)


# ------------------------------------------------------------------ writers: case, folder -> (option, independent points)

def number(value, comma):
    text = f"{value:.4f}"
    return text.replace(".", ",") if comma else text


def gocad(case, path):
    plane = case["plane"]
    grid = plane.grid(13, 9)
    frame = Frame(case)
    xy, z = UNIT_NAME[case["unit"]]
    lines = ["GOCAD TSurf 1", "HEADER {", f"name: {plane.name}", "}"]
    if case["stated"] == "stated":
        lines += ["GOCAD_ORIGINAL_COORDINATE_SYSTEM", "NAME Default", 'AXIS_NAME "X" "Y" "Z"',
                  f'AXIS_UNIT "{xy}" "{xy}" "{z}"', f"ZPOSITIVE {'Depth' if case['sign'] == 'down' else 'Elevation'}",
                  "END_ORIGINAL_COORDINATE_SYSTEM"]
    lines.append("TFACE")
    for i, p in enumerate(frame.write(grid)):
        lines.append(f"VRTX {i + 1} {p[0]:.5f} {p[1]:.5f} {p[2]:.6f}")
    tri = triangles_of(grid)
    if case["order"] != "sorted":
        np.random.default_rng(3).shuffle(tri)
    lines += [f"TRGL {a + 1} {b + 1} {c + 1}" for a, b, c in tri] + ["END", ""]
    open(path, "w").write("\n".join(lines))
    read = [tuple(map(float, l.split()[2:5])) for l in open(path) if l.startswith("VRTX")]
    return suffix(case, case["stated"] == "stated", case["stated"] == "stated"), read


def poly_data(case):
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkTriangle
    grid = case["plane"].grid(13, 9)
    points = vtkPoints()
    points.SetDataTypeToDouble()
    for p in Frame(case).write(grid):
        points.InsertNextPoint(p)
    cells = vtkCellArray()
    for t in triangles_of(grid):
        cell = vtkTriangle()
        for i, n in enumerate(t):
            cell.GetPointIds().SetId(i, n)
        cells.InsertNextCell(cell)
    data = vtkPolyData()
    data.SetPoints(points)
    data.SetPolys(cells)
    return data


def vtk_writer(writer_module, writer_name, reader_name, ascii_text):
    def write(case, path):
        import importlib
        module = importlib.import_module(writer_module)
        writer = getattr(module, writer_name)()
        writer.SetInputData(poly_data(case))
        writer.SetFileName(path)
        if hasattr(writer, "SetFileTypeToASCII"):
            writer.SetFileTypeToASCII() if ascii_text else writer.SetFileTypeToBinary()
        elif hasattr(writer, "SetDataModeToAscii"):
            writer.SetDataModeToAscii() if ascii_text else writer.SetDataModeToAppended()
        writer.Write()
        reader = getattr(module, reader_name)()
        reader.SetFileName(path)
        reader.Update()
        data = reader.GetOutput()
        return suffix(case, False, False), [data.GetPoint(i) for i in range(data.GetNumberOfPoints())]
    return write


def obj(case, path):
    grid = case["plane"].grid(13, 9)
    p = Frame(case).write(grid)
    lines = ["# exported", f"o {case['plane'].name.replace(' ', '_')}"]
    lines += [f"v {x:.5f} {y:.5f} {z:.6f}" for x, y, z in p]
    lines += [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in triangles_of(grid)]
    open(path, "w").write("\n".join(lines) + "\n")
    read = [tuple(map(float, l.split()[1:4])) for l in open(path) if l.startswith("v ")]
    return suffix(case, False, False), read


def xtgeo_surface(fformat):
    def write(case, path):
        import xtgeo
        frame = Frame(case)
        nx, ny = 34, 30
        x0, y0 = ORIGIN[0] - 25, ORIGIN[1] - 25
        values = np.array([[case["plane"].height(x0 + 25 * i, y0 + 25 * j) for j in range(ny)] for i in range(nx)])
        values *= frame.z * frame.sign
        masked = np.ma.array(values, mask=np.zeros_like(values, bool))
        if case["null"] != "none":
            masked.mask[10:13, 8:11] = True
        surface = xtgeo.RegularSurface(ncol=nx, nrow=ny, xinc=25 * frame.xy, yinc=25 * frame.xy, xori=x0 * frame.xy,
                                       yori=y0 * frame.xy, values=masked)
        surface.to_file(path, fformat=fformat)
        again = xtgeo.surface_from_file(path, fformat=fformat)
        x, y = again.get_xy_values()
        z = again.values
        points = [(x[i, j], y[i, j], z[i, j]) for i in range(nx) for j in range(ny) if not np.ma.getmaskarray(z)[i, j]]
        return suffix(case, False, False), points
    return write


COLUMNS = {"xyz": ["x", "y", "z"], "yxz": ["y", "x", "z"], "zxy": ["z", "x", "y"], "zyx": ["z", "y", "x"]}
ALIASES = {
    "short": {"x": "x", "y": "y", "z": "z"},
    "geographic": {"x": "Easting", "y": "Northing", "z": "Depth"},
    "upper": {"x": "X_COORD", "y": "Y_COORD", "z": "TVDSS"},
    "units": {"x": "X (m)", "y": "Y (m)", "z": "Z (m)"},
}


def z_name(case, names):
    """The name of the column of z says its direction where it can."""
    z = names["z"]
    if case["sign"] == "up" and z in ("Depth", "TVDSS"):
        z = "Elevation"
    if case["unit"] in ("ms", "s") and z in ("Depth", "TVDSS", "Elevation"):
        z = "TWT" if case["sign"] == "down" else "Z"
    if names is ALIASES["units"]:
        z = f"Z ({UNIT_NAME[case['unit']][1]})"
    return z


def table_text(case, columns, rows, names):
    separator = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}[case["separator"]]
    decimal_comma = case["separator"] in ("semicolon", "tab") and case["decimal"] == "comma"
    lines = []
    if case["comment"] == "comments":
        lines += ["# picked by a person", "#", "# projection ED50 / UTM 31"]
    if names is not None:
        lines.append(separator.join(names[c] if separator != " " else names[c].replace(" ", "_") for c in columns))
    for row in rows:
        words = [v if isinstance(v, str) else number(v, decimal_comma) for v in (row[c] for c in columns)]
        lines.append(separator.join(words))
    if case["comment"] == "comments":
        lines.append("# end")
    return ("\r\n" if case["comment"] == "dos" else "\n").join(lines) + "\n"


def points_table(case, path):
    frame = Frame(case)
    points, dead = with_nulls(frame.write(case["plane"].grid(15, 11)), case["null"])
    order = np.arange(len(points))
    if case["order"] == "shuffled":
        np.random.default_rng(5).shuffle(order)
    elif case["order"] == "reversed":
        order = order[::-1]
    names = dict(ALIASES[case["names"]])
    if case["names"] == "units":
        xy, z = UNIT_NAME[case["unit"]]
        names = {"x": f"X ({xy})", "y": f"Y ({xy})", "z": f"Z ({z})"}
    else:
        names["z"] = z_name(case, ALIASES[case["names"]])
    rows = [dict(zip("xyz", points[i])) for i in order]
    open(path, "w", newline="").write(table_text(case, COLUMNS[case["columns"]], rows, names))
    import pandas
    separator = {"comma": ",", "semicolon": ";", "tab": "\t", "blank": " "}[case["separator"]]
    decimal = "," if case["separator"] in ("semicolon", "tab") and case["decimal"] == "comma" else "."
    frame_read = pandas.read_csv(path, sep=separator, comment="#", decimal=decimal)
    columns = {c: n for c, n in zip(COLUMNS[case["columns"]], frame_read.columns)}
    read = frame_read[[columns["x"], columns["y"], columns["z"]]].to_numpy(float)
    if case["null"] != "none":
        read = read[np.abs(read[:, 2] - float(case["null"])) > 1e-3 * abs(float(case["null"]))]
    return suffix(case, case["names"] == "units", False), read


def sticks_table(case, path):
    frame = Frame(case)
    grid = case["plane"].grid(9, 7)
    sticks = list(range(len(grid)))
    rng = np.random.default_rng(8)
    if case["order"] == "shuffled":
        rng.shuffle(sticks)
    elif case["order"] == "reversed":
        sticks = sticks[::-1]
    rows = []
    for n, s in enumerate(sticks):
        stick = grid[s][:: -1 if n % 2 and case["order"] != "sorted" else 1]
        for p in frame.write(stick):
            rows.append({"fault": case["plane"].name, "stick": str(s + 1), **dict(zip("xyz", p))})
    names = {"fault": "fault", "stick": "stick", "x": "x", "y": "y", "z": "z"}
    if case["names"] == "geographic":
        names = {"fault": "Fault_Name", "stick": "Stick_ID", "x": "Easting", "y": "Northing", "z": z_name(case, ALIASES["geographic"])}
    elif case["names"] == "upper":
        names = {"fault": "NAME", "stick": "STICK", "x": "X", "y": "Y", "z": z_name(case, ALIASES["upper"])}
    elif case["names"] == "units":
        xy, z = UNIT_NAME[case["unit"]]
        names = {"fault": "Fault", "stick": "Stick", "x": f"X ({xy})", "y": f"Y ({xy})", "z": f"Z ({z})"}
    columns = COLUMNS[case["columns"]]
    columns = {"xyz": ["fault", "stick"] + columns, "yxz": columns + ["fault", "stick"],
               "zxy": ["stick"] + columns + ["fault"], "zyx": columns + ["stick", "fault"]}[case["columns"]]
    # A name with a blank cannot stand in a table of blanks.
    if case["separator"] == "blank":
        rows = [{**r, "fault": r["fault"].replace(" ", "_")} for r in rows]
    open(path, "w", newline="").write(table_text(case, columns, rows, names))
    read = [[r[c] for c in "xyz"] for r in rows]
    return suffix(case, case["names"] == "units", False), read


def charisma(case, path):
    frame = Frame(case)
    grid = case["plane"].grid(9, 7)
    sticks = list(range(len(grid)))
    if case["order"] == "shuffled":
        np.random.default_rng(9).shuffle(sticks)
    elif case["order"] == "reversed":
        sticks = sticks[::-1]
    lines = []
    for s in sticks:
        for p in frame.write(grid[s]):
            lines.append(f"INLINE- {100 + s:>8} {200:>8} {p[0]:>14.3f} {p[1]:>14.3f} {p[2]:>12.4f} {case['plane'].name} {s + 1}")
    open(path, "w").write("\n".join(lines) + "\n")
    read = [tuple(map(float, l.split()[3:6])) for l in open(path)]
    return suffix(case, False, False), read


def pline(case, path):
    frame = Frame(case)
    grid = case["plane"].grid(9, 7)
    xy, z = UNIT_NAME[case["unit"]]
    lines = ["GOCAD PLine 1", "HEADER {", f"name: {case['plane'].name}", "}"]
    if case["stated"] == "stated":
        lines += ["GOCAD_ORIGINAL_COORDINATE_SYSTEM", "NAME Default", f'AXIS_UNIT "{xy}" "{xy}" "{z}"',
                  f"ZPOSITIVE {'Depth' if case['sign'] == 'down' else 'Elevation'}", "END_ORIGINAL_COORDINATE_SYSTEM"]
    n = 0
    order = list(range(len(grid)))
    if case["order"] == "shuffled":
        np.random.default_rng(2).shuffle(order)
    for s in order:
        lines.append("ILINE")
        first = n + 1
        for p in frame.write(grid[s]):
            n += 1
            lines.append(f"VRTX {n} {p[0]:.5f} {p[1]:.5f} {p[2]:.6f}")
        lines += [f"SEG {k} {k + 1}" for k in range(first, n)]
    open(path, "w").write("\n".join(lines + ["END", ""]))
    read = [tuple(map(float, l.split()[2:5])) for l in open(path) if l.startswith("VRTX")]
    return suffix(case, case["stated"] == "stated", True), read


def xtgeo_points(case, path):
    import pandas
    import xtgeo
    points, _ = with_nulls(Frame(case).write(case["plane"].grid(15, 11)), "none")
    frame = pandas.DataFrame(points, columns=["X_UTME", "Y_UTMN", "Z_TVDSS"])
    xtgeo.Points(frame).to_file(path, fformat="xyz")
    read = xtgeo.points_from_file(path, fformat="xyz").get_dataframe().to_numpy(float)[:, :3]
    return suffix(case, False, False), read


def petrel_points(case, path):
    points, _ = with_nulls(Frame(case).write(case["plane"].grid(15, 11)), "none")
    lines = ["# Petrel Points with attributes", f"# Unit in X and Y direction: {UNIT_NAME[case['unit']][0]}",
             f"# Unit in depth: {UNIT_NAME[case['unit']][1]}", "VERSION 1", "BEGIN HEADER", "X", "Y", "Z",
             "FLOAT,Amplitude", "END HEADER"]
    lines += [f"{x:.5f} {y:.5f} {z:.6f} {(7 * i) % 101 - 50:.2f}" for i, (x, y, z) in enumerate(points)]
    open(path, "w").write("\n".join(lines) + "\n")
    return suffix(case, True, False), points


SURFACES = {
    # name: (ending, writer, objects, dimensions that the format has)
    "tsurf": (".ts", gocad, "fh", {"stated", "order"}),
    "vtp-text": (".vtp", vtk_writer("vtkmodules.vtkIOXML", "vtkXMLPolyDataWriter", "vtkXMLPolyDataReader", True), "fh", set()),
    "vtp": (".vtp", vtk_writer("vtkmodules.vtkIOXML", "vtkXMLPolyDataWriter", "vtkXMLPolyDataReader", False), "fh", set()),
    "vtk": (".vtk", vtk_writer("vtkmodules.vtkIOLegacy", "vtkPolyDataWriter", "vtkPolyDataReader", True), "fh", set()),
    "stl": (".stl", vtk_writer("vtkmodules.vtkIOGeometry", "vtkSTLWriter", "vtkSTLReader", True), "fh", set()),
    "ply": (".ply", vtk_writer("vtkmodules.vtkIOPLY", "vtkPLYWriter", "vtkPLYReader", True), "fh", set()),
    "obj": (".obj", obj, "fh", set()),
    "irap": (".irap", xtgeo_surface("irap_ascii"), "h", {"null"}),
    "zmap": (".zmap", xtgeo_surface("zmap_ascii"), "h", {"null"}),
    "points": (".csv", points_table, "fh", {"null", "order", "columns", "names", "separator", "decimal", "comment"}),
    "sticks": (".csv", sticks_table, "f", {"order", "columns", "names", "separator", "decimal", "comment"}),
    "charisma": (".charisma", charisma, "f", {"order"}),
    "pline": (".pl", pline, "f", {"stated", "order"}),
    "xtgeo-points": (".xyz", xtgeo_points, "fh", set()),
    "petrel-points": (".pts", petrel_points, "fh", set()),
}

DIMENSIONS = {
    "image": list(IMAGES),
    "unit": ["m", "ft", "ft-all", "ms", "s"],
    "sign": ["up", "down"],
    "stated": ["stated", "silent"],
    "null": ["none", "-999.25", "-9999", "1e30"],
    "order": ["sorted", "reversed", "shuffled"],
    "columns": list(COLUMNS),
    "names": list(ALIASES),
    "separator": ["comma", "semicolon", "tab", "blank"],
    "decimal": ["point", "comma"],
    "comment": ["plain", "comments", "dos"],
}


def fits(case):
    """Whether a combination can exist: times need an image in time, or one that was converted."""
    is_time = case["unit"] in ("ms", "s")
    if is_time != (case["image"] in ("time", "converted")):
        # Depths in an image that was converted from time are usual, too.
        return case["image"] == "converted" and not is_time
    return True


def pairwise(dimensions, fits):
    """Cases in which each pair of values of two dimensions occurs, by a greedy choice in a fixed order."""
    names = list(dimensions)
    todo = set()
    for a, b in itertools.combinations(names, 2):
        todo |= {((a, x), (b, y)) for x in dimensions[a] for y in dimensions[b]}
    rng = np.random.default_rng(1)
    cases = []
    for _ in range(3000):
        best, gain = None, 0
        for _ in range(40):
            case = {n: dimensions[n][rng.integers(len(dimensions[n]))] for n in names}
            if todo:
                ((a, x), (b, y)) = sorted(todo)[rng.integers(len(todo))]
                case[a], case[b] = x, y
            if not fits(case):
                continue
            count = sum(((a, case[a]), (b, case[b])) in todo for a, b in itertools.combinations(names, 2))
            if count > gain:
                best, gain = case, count
        if best is None:
            break
        cases.append(best)
        todo -= {((a, best[a]), (b, best[b])) for a, b in itertools.combinations(names, 2)}
    return cases


def surface_cases():
    for name, (ending, writer, objects, has) in SURFACES.items():
        own = {k: v for k, v in DIMENSIONS.items() if k in has or k in ("image", "unit", "sign")}
        own["plane"] = list(objects)
        for case in pairwise(own, fits):
            full = {k: v[0] for k, v in DIMENSIONS.items()}
            full.update(case)
            full.update(format=name, plane=FAULT if case["plane"] == "f" else HORIZON)
            yield full


# ------------------------------------------------------------------ judges

def to_metres(points, image):
    p = np.array(points, float).reshape(-1, 3).copy()
    p[:, :2] /= in_xy(image)
    to_image = IMAGES[image][1]
    p[:, 2] /= to_image(1.0)
    return p


def clipped_area(plane, triangles):
    """Area of triangles inside the image's box, by dividing them finely."""
    low = np.array([ORIGIN[0], ORIGIN[1], -TOP - EXTENT[2]])
    high = np.array([ORIGIN[0] + EXTENT[0], ORIGIN[1] + EXTENT[1], -TOP])
    total = 0.0
    for t in triangles:
        n = 12
        area = 0.5 * np.linalg.norm(np.cross(t[1] - t[0], t[2] - t[0])) / (n * n)
        for i in range(n):
            for j in range(n - i):
                for up in (True, False):
                    if not up and j == n - i - 1:
                        continue
                    u, v = (i + 1 / 3, j + 1 / 3) if up else (i + 2 / 3, j + 2 / 3)
                    p = t[0] + (u * (t[1] - t[0]) + v * (t[2] - t[0])) / n
                    total += area * bool(np.all(p >= low) and np.all(p <= high))
    return total


AREA = {}


def area_of(plane):
    if plane.name not in AREA:
        grid = plane.grid(13, 9)
        points = grid.reshape(-1, 3)
        AREA[plane.name] = clipped_area(plane, [points[list(t)] for t in triangles_of(grid)])
    return AREA[plane.name]


def read_tsurf(path):
    nodes, facets, names, shift = {}, [], [], 0
    for line in open(path):
        words = line.split()
        if line.startswith("name:"):
            names.append(line[5:].strip())
            shift = len(nodes)
        elif words and words[0] == "VRTX":
            nodes[shift + int(words[1])] = np.array(list(map(float, words[2:5])))
        elif words and words[0] == "TRGL":
            facets.append([shift + int(w) for w in words[1:4]])
    return names, nodes, facets


def run(args, folder):
    return subprocess.run(args, cwd=folder, capture_output=True, text=True, timeout=120)


def judge_surface(atomesh, case, folder, name):
    ending, writer, _, _ = SURFACES[case["format"]]
    path = os.path.join(folder, name + ending)
    text, independent = writer(case, path)
    plane, image = case["plane"], case["image"]
    off = np.abs(plane.distance(Frame(case).read(independent))).max()
    # Text and 32-bit numbers round coordinates of millions.
    assert off < 1.5, f"the file itself is wrong: {name}: {off}"
    options = IMAGES[image][0]
    kind = ",horizon" if plane.is_horizon else ",fault"
    result = run([atomesh, "mesh", "image.npy", *options, "--feature", "none", "--distance", "4", "--surface",
                  name + ending + kind + text, "-o", name + ".vtu"], folder)
    if result.returncode != 0:
        return "refused", result.stderr.strip().splitlines()[-1] if result.stderr.strip() else "no word"
    note = next((l for l in re.sub(r"\n {12}", " ", result.stdout).splitlines() if l.startswith("note") and "surface" in l), "")
    result = run([atomesh, "surface", name + ".vtu", "-o", name + ".out.ts"], folder)
    if result.returncode != 0:
        return "wrong", "no surface: " + result.stderr.strip()
    names, nodes, facets = read_tsurf(os.path.join(folder, name + ".out.ts"))
    points = {k: to_metres(v, image)[0] for k, v in nodes.items()}
    if not facets:
        return "wrong", "no face"
    off = np.abs(plane.distance(list(points.values()))).max()
    area = sum(0.5 * np.linalg.norm(np.cross(points[b] - points[a], points[c] - points[a])) for a, b, c in facets)
    share = area / area_of(plane)
    # A sample is 12 m high; a hole of nulls may take 2 % of a grid.
    if off > 12.0:
        return "wrong", f"{off:.0f} m off; {note}"
    if not 0.93 < share < 1.07:
        return "wrong", f"area {share:.2f}; {note}"
    return "right", name + ending + kind + text


# ------------------------------------------------------------------ wells

# More than half a sample below the top: nearer ends of wells are moved to the side of the image.
HEAD = np.array([ORIGIN[0] + 300.0, ORIGIN[1] + 250.0, -TOP - 8.0])


def well_path():
    """A straight, deviated well: inclination 30 degrees towards azimuth 40."""
    i, a = math.radians(30), math.radians(40)
    direction = np.array([math.sin(i) * math.sin(a), math.sin(i) * math.cos(a), -math.cos(i)])
    return [HEAD + t * direction for t in np.linspace(0, 270, 10)], direction


def well_table(case, path):
    frame = Frame(case)
    points, _ = well_path()
    rows = [{**dict(zip("xyz", p)), "radius": 0.5 * frame.xy, "diameter": 1.0 * frame.xy} for p in frame.write(points)]
    size = case["size"]
    names = {**ALIASES[case["names"]], "radius": "radius", "diameter": "diameter"}
    if case["names"] == "units":
        xy, z = UNIT_NAME[case["unit"]]
        names.update({"x": f"X ({xy})", "y": f"Y ({xy})", "z": f"Z ({z})"})
    else:
        names["z"] = z_name(case, ALIASES[case["names"]])
    columns = COLUMNS[case["columns"]] + [size]
    if case["columns"] == "zxy":
        columns = [size] + COLUMNS[case["columns"]]
    open(path, "w", newline="").write(table_text(case, columns, rows, names))
    return suffix(case, case["names"] == "units", False)


# The height of measured depth 0 above the datum of z: the kelly bushing, in metres.
BUSHING = 25.0


def survey(case):
    """Names, units and values of the columns of a deviation survey, and the wellhead: x, y, height."""
    frame = Frame(case)
    _, direction = well_path()
    above = (BUSHING - HEAD[2]) / -direction[2]
    head = frame.write(HEAD - above * direction)[0] * (1, 1, frame.sign)
    depths = np.linspace(0, above + 270, 12) * frame.xy
    return head, [dict(md=d, inc=30.0, azi=40.0, radius=0.5 * frame.xy, diameter=frame.xy) for d in depths]


SURVEY_NAMES = {
    "short": {"md": "md", "inc": "inc", "azi": "azi"},
    "geographic": {"md": "MD", "inc": "Inclination", "azi": "Azimuth"},
    "upper": {"md": "MEASURED_DEPTH", "inc": "INCL", "azi": "AZIM"},
}
SURVEY_COLUMNS = {"xyz": ["md", "inc", "azi"], "yxz": ["inc", "azi", "md"], "zxy": ["azi", "md", "inc"], "zyx": ["azi", "inc", "md"]}


def well_survey(case, path):
    head, rows = survey(case)
    unit, size = UNIT_NAME[case["unit"]][0], case["size"]
    if case["names"] == "units":
        names = {"md": f"MD ({unit})", "inc": "INC (deg)", "azi": "AZI (deg)"}
    else:
        names = SURVEY_NAMES[case["names"]]
    columns = SURVEY_COLUMNS[case["columns"]] + [size]
    text = table_text(case, columns, rows, {**names, size: size})
    by_comment = case["stated"] == "stated"
    if by_comment:
        lines = [f"# WELL HEAD X-COORDINATE: {head[0]:.4f} ({unit})", f"# WELL HEAD Y-COORDINATE: {head[1]:.4f} ({unit})",
                 f"# WELL DATUM (KB, Kelly bushing, from MSL): {head[2]:.4f} ({unit})"]
        text = "\n".join(lines) + "\n" + text
    open(path, "w", newline="").write(text)
    # Names of columns say nothing about the wellhead of the option.
    option = suffix(case, by_comment, False)
    return option if by_comment else f"{option},head={head[0]:.4f},{head[1]:.4f},{head[2]:.4f}"


def well_las(case, path):
    import lasio
    head, rows = survey(case)
    unit = UNIT_NAME[case["unit"]][0]
    las = lasio.LASFile()
    las.well["WELL"].value = "B-4"
    for name, value in zip(("XCOORD", "YCOORD", "EKB"), head):
        las.well[name] = lasio.HeaderItem(name, unit=unit, value=round(value, 4))
    for name, mnemonic, of in (("md", "DEPT", unit), ("inc", "INCL", "deg"), ("azi", "AZIM", "deg"), ("radius", "RADIUS", unit)):
        las.append_curve(mnemonic, np.array([row[name] for row in rows]), unit=of)
    las.write(path, version=2.0)
    again = lasio.read(path)
    assert np.allclose(again["DEPT"], [row["md"] for row in rows])
    return ""


WELL_DIMENSIONS = {k: DIMENSIONS[k] for k in ("image", "unit", "sign", "columns", "names", "separator", "decimal", "comment")}
WELL_DIMENSIONS["size"] = ["radius", "diameter"]
# Deviation surveys have one unit and are in depth.
SURVEY_DIMENSIONS = {**WELL_DIMENSIONS, "stated": DIMENSIONS["stated"], "unit": ["m", "ft-all"], "sign": ["up"]}

WELLS = {
    # name: (ending, writer, dimensions)
    "well": (".csv", well_table, WELL_DIMENSIONS),
    "survey": (".dev", well_survey, SURVEY_DIMENSIONS),
    "las": (".las", well_las, {"image": DIMENSIONS["image"], "unit": ["m", "ft-all"], "sign": ["up"]}),
}


def well_cases():
    for name, (_, _, dimensions) in WELLS.items():
        for case in pairwise(dimensions, fits):
            yield {**{k: v[0] for k, v in DIMENSIONS.items()}, **case, "format": name}


def fixed_nodes(path):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOXML import vtkXMLUnstructuredGridReader
    reader = vtkXMLUnstructuredGridReader()
    reader.SetFileName(path)
    reader.Update()
    grid = reader.GetOutput()
    points = vtk_to_numpy(grid.GetPoints().GetData())
    kinds = vtk_to_numpy(grid.GetPointData().GetArray("atom_kind"))
    return points[kinds == 4]


def judge_well(atomesh, case, folder, name):
    ending, writer, _ = WELLS[case["format"]]
    file = name + ending
    text = writer(case, os.path.join(folder, file))
    image = case["image"]
    result = run([atomesh, "mesh", "image.npy", *IMAGES[image][0], "--feature", "none", "--distance", "4", "--well",
                  file + text, "--well-distance", "1", "-o", name + ".vtu"], folder)
    if result.returncode != 0:
        return "refused", result.stderr.strip().splitlines()[-1] if result.stderr.strip() else "no word"
    nodes = to_metres(fixed_nodes(os.path.join(folder, name + ".vtu")), image)
    points, direction = well_path()
    along = (nodes - HEAD) @ direction
    off = np.linalg.norm(nodes - HEAD - np.outer(along, direction), axis=1)
    # Atoms on the axis, and around it at the bore's radius.
    if len(nodes) < 5 or off.max() > 2.0:
        return "wrong", f"{len(nodes)} nodes, up to {off.max() if len(nodes) else math.nan:.1f} m off"
    if along.min() > 30 or along.max() < 240:
        return "wrong", f"from {along.min():.0f} to {along.max():.0f} m of 0 to 270"
    return "right", file + text


# Number of files of each format that `--keep` copies.
KEPT = 3


def kept_case(case, option):
    """What a test needs to judge a file: options, and the object in metres."""
    image = case["image"]
    entry = {"option": option, "image": IMAGES[image][0], "metres": [1 / in_xy(image), 1 / in_xy(image), 1 / IMAGES[image][1](1.0)]}
    if case["format"] in WELLS:
        _, direction = well_path()
        return {**entry, "head": list(HEAD), "direction": list(direction)}
    return {**entry, "centre": list(CENTRE), "normal": list(case["plane"].normal), "area": area_of(case["plane"])}


def print_table(table):
    """Prints the numbers of right, wrong and refused combinations of each format, and returns the exit code."""
    total = {v: sum(counts[v] for counts in table.values()) for v in ("right", "wrong", "refused")}
    for name, counts in [*table.items(), ("all", total)]:
        print(f"{name:>14} {counts['right']:>5} right {counts['wrong']:>5} wrong {counts['refused']:>5} refused")
    return int(total["wrong"] > 0 or 10 * total["refused"] > sum(total.values()))


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("atomesh")
    parser.add_argument("folder")
    parser.add_argument("--only", help="formats, separated by commas")
    parser.add_argument("--list", action="store_true", help="print the combinations only")
    parser.add_argument("--keep", metavar="FILES", help="copy some files of each format to this folder")
    args = parser.parse_args()
    os.makedirs(args.folder, exist_ok=True)
    kept = []
    atomesh = os.path.abspath(args.atomesh)
    rng = np.random.default_rng(0)
    np.save(os.path.join(args.folder, "image.npy"), rng.normal(size=DIMS[::-1]).astype("f4"))
    only = args.only.split(",") if args.only else None
    cases = [(c, judge_surface) for c in surface_cases()] + [(c, judge_well) for c in well_cases()]
    cases = [(c, j) for c, j in cases if not only or c["format"] in only]
    table = {}
    for n, (case, judge) in enumerate(cases):
        words = [str(case[k]) for k in ("image", "unit", "sign", "stated", "null", "order", "columns", "names", "separator",
                                        "decimal", "comment")]
        if args.list:
            print(case["format"], *words)
            continue
        verdict, why = judge(atomesh, case, args.folder, f"{case['format']}{n}")
        counts = table.setdefault(case["format"], {"right": 0, "wrong": 0, "refused": 0})
        counts[verdict] += 1
        if verdict == "right" and args.keep and counts[verdict] <= KEPT:
            shutil.copy(os.path.join(args.folder, why.split(",")[0]), args.keep)
            kept.append(kept_case(case, why))
        if verdict != "right":
            plane = case["plane"].name if "plane" in case else ""
            print(f"{verdict}: {case['format']}{n}: {plane}", *words, "|", why, file=sys.stderr)
    if args.keep:
        with open(os.path.join(args.keep, "cases.json"), "w") as out:
            out.write("[\n" + ",\n".join(json.dumps(entry) for entry in kept) + "\n]\n")
    return print_table(table)


if __name__ == "__main__":
    sys.exit(main())
