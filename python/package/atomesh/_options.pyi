"""The options of every verb, as `stubs.py` writes them: what the command line declares."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

_Path: TypeAlias = str | os.PathLike[str]
_Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
#: Words, numbers, points (x, y, z), boxes of two points, files, and arrays where a file is asked for.
_Value: TypeAlias = str | os.PathLike[str] | _Number | Sequence[_Number] | Sequence[Sequence[_Number]] | npt.NDArray[Any]
_Values: TypeAlias = _Value | Sequence[_Value] | Mapping[Any, _Value]

class MeshOptions(TypedDict, total=False):
    #: Nominal distance between atoms, in samples, or MIN:MAX [default: 2.7:8]
    distance: _Value | None
    #: What a distance MIN:MAX follows: gaps (MAX, but down to MIN where features run close
    #: together or cross at shallow angles; the default), features (MIN on them, increasing away
    #: from them), image (MIN where it is darkest, MAX where it is brightest; the other way round
    #: where bright features are followed), laplacian (of the potential), or a file with a distance
    #: per sample
    distance_from: _Value | None
    #: The features to follow [default: auto]
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential"] | None
    #: Scale of the features in samples [default: by the kind of feature]
    sigma: _Number | None
    #: Smallest strength of a feature, in units of the feature image [default: automatic, printed]
    threshold: _Number | None
    #: Weights F,H in (0, 1] of faults and horizons where both are followed [default: 1,1]
    feature_weights: _Value | None
    #: What is wanted of a label: VALUE:distance=D,name=NAME (distance between atoms in it, in
    #: samples), or VALUE:into=VALUE (it becomes part of another label); may be repeated
    label: _Values | None
    #: Paths: a point of the object, in physical coordinates; may be repeated
    object: _Values | None
    #: Paths: a point of the background; may be repeated [default: the image's outermost samples]
    background: _Values | None
    #: Also write the potential b(x)
    potential_out: _Path | None
    #: Also write the lines where features, or a feature and a side of the box, meet at less than
    #: 30 degrees, with their angles
    lines: _Path | None
    #: Also write a page to look at: mesh, image and figures in one HTML file for any browser
    page: _Path | None
    #: Keep what each stage gives in a folder: the same command, started again after it was ended,
    #: goes on from there and makes the same mesh
    checkpoint: _Path | None
    #: Also write the faces on features with the number of the surface of each, as `atomesh
    #: surface` does
    surfaces: _Path | None
    #: Atoms on features, or alongside [default: on; alongside with --cells voronoi]
    align: Literal["on", "alongside"] | None
    #: Cells of the mesh [default: tets; voronoi with --align alongside]
    cells: Literal["tets", "voronoi"] | None
    #: Weight of the image against the lattice in [0, 1): a number, or an image file [default: 0.5]
    beta: _Value | None
    #: Initial positions of atoms [default: fcc]
    seeding: Literal["fcc", "grown", "refine", "canny", "guide", "projection"] | None
    #: Largest number of atoms that --seeding guide places [default: as many as find room]
    max_atoms: int | None
    #: Fixed atoms (wells, sources): a CSV file of x,y,z (x,y in 2-D) in the image's physical
    #: coordinates
    atoms_from: _Path | None
    #: A well: fixed atoms along the trajectory in a CSV file of lines x,y,z,radius (x,y,radius in
    #: 2-D), in the image's physical coordinates; may be repeated
    well: _Values | None
    #: Distance between atoms at wells, in samples; it increases to --distance away from them
    well_distance: _Number | None
    #: Evaluator of the lattice energy [default: pairwise]
    evaluator: Literal["pairwise", "sampled"] | None
    #: Weight in [0, 1] of the energy between atoms against their Laplacian coordinates, which make
    #: the lattice more regular; 0.7 is typical with them [default: 1, without]
    kappa: _Number | None
    #: How atoms are moved [default: lbfgs]
    optimizer: Literal["lbfgs", "descent", "genetic"] | None
    #: Most rounds of moving atoms a little by chance and minimising; they end when one gains
    #: nothing [default: 1; 3 with --kappa]
    rounds: int | None
    #: Number of initial passes on a smoother potential [default: 0]
    coarse_to_fine: int | None
    #: Smallest dihedral angle aimed at, in degrees, the largest being 180 minus it; in 2-D the
    #: smallest angle [default: 30]
    min_dihedral: _Number | None
    #: How slivers are removed [default: joe]
    slivers: Literal["joe", "exude", "none"] | None
    #: Voronoi cells without their smallest faces: nodes closer together than this fraction of the
    #: cells' radius are merged [default: 0]
    weld: _Number | None
    #: Smooth the triangles of a 2-D image where it is flat; nodes on features stay
    smooth: Literal["cvt", "odt"] | None
    #: Lattice space: samples, physical, shape (physical, but as many samples to a cell as with
    #: samples), or a scale per axis SX,SY,SZ (SX,SY in 2-D) [default: samples]
    metric: _Value | None
    #: Makes depth in metres of two-way time: one velocity in m/s for the whole image, or a file of
    #: interval velocities in m/s on a grid of its own in two-way time, by which the image is
    #: stretched
    velocity: _Value | None
    #: Seed of the random perturbations [default: 1]
    rng_seed: int | None
    #: Write the report as JSON
    report: _Path | None
    #: Write the lattice before atoms move and after each round or generation, for ParaView; the
    #: report then has the energy and the quality of each
    trace: _Path | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Options from a TOML file; those typed here win
    config: _Path | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class FeatureOptions(TypedDict, total=False):
    #: Also write the lines at which features cross, branch off one another and end, with the angle
    #: and the two sheets (in 2-D the points): .vtp
    lines: _Path | None
    #: The features to find
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential"] | None
    #: Nominal distance between atoms, in samples: the valleys of the potential are a quarter of it
    #: wide
    distance: _Number | None
    #: Scale of the features in samples [default: by the kind of feature]
    sigma: _Number | None
    #: Smallest strength of a feature, in units of the feature image [default: automatic, printed]
    threshold: _Number | None
    #: Weights F,H in (0, 1] of faults and horizons where both are followed [default: 1,1]
    feature_weights: _Value | None
    #: Paths: a point of the object, in physical coordinates; may be repeated
    object: _Values | None
    #: Paths: a point of the background; may be repeated [default: the image's outermost samples]
    background: _Values | None
    #: Paths: write the fraction of them that passes through each sample: .vti, .npy, .nrrd, .mha,
    #: .nii or .png
    confidence_out: _Path | None
    #: Paths: seed of the random points
    rng_seed: int | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class InfoOptions(TypedDict, total=False):
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ConvertOptions(TypedDict, total=False):
    #: Makes depth in metres of an image in two-way time: one velocity in m/s, or a file of
    #: interval velocities in m/s on a grid of its own in two-way time, by which the image is
    #: stretched
    velocity: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class QualityOptions(TypedDict, total=False):
    #: Exact distance to the features, as `synth --truth` writes it
    truth: _Path | None
    #: Also write the lines where features, or a feature and a side of the box, meet at less than
    #: 30 degrees, with their angles
    lines: _Path | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ReportOptions(TypedDict, total=False):
    #: What mesh --report has written, for its fidelity, notes and cost [default: figures are
    #: measured from the mesh]
    figures: _Path | None
    #: The page's heading [default: the mesh's name]
    title: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ValidateOptions(TypedDict, total=False):
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class FlowOptions(TypedDict, total=False):
    #: Pressure (Pa) of a side of the box: xmin, xmax, ymin ..., the image's axes, x the fastest in
    #: memory. Sides without one are closed
    pressure: _Values | None
    #: How faults resist flow across them: closed, open, or the factor, from 0 to 1, of the
    #: permeability there [default: closed for flow, open for export]
    faults: _Value | None
    #: Thickness (m) of the layer to which the factor of --faults applies [default: from cell to
    #: cell]
    fault_thickness: _Number | None
    #: The factor of some surfaces: by the number or name that `atomesh surface MESH` prints, such
    #: as fault3:0.01, by the regions between which they lie, such as 1/11:0, or by a pattern of
    #: names with * and ?, such as 'interface_*_11:0'; may be repeated, and the last that picks a
    #: surface holds; or a CSV file of lines surface,factor[,thickness]
    fault_multiplier: _Values | None
    #: The surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    #: pairs of regions and patterns, as --fault-multiplier has them. Others are open [default:
    #: faults]
    barriers: _Value | None
    #: Permeability in m^2 (1 mD is 9.87e-16 m^2): K; KX,KY,KZ; KXX,KYY,KZZ,KXY,KYZ,KXZ (in 2-D K;
    #: KX,KY; KXX,KYY,KXY); a CSV file of lines region,K; or a cell array of the mesh
    permeability: _Value | None
    #: Makes depth in metres of two-way time: one velocity in m/s for the whole mesh, or a file of
    #: interval velocities in m/s on a grid of its own in two-way time; sources and sinks are given
    #: in depth then
    velocity: _Value | None
    #: Viscosity in Pa s
    viscosity: _Number | None
    #: Write streamlines that carry equal rates, for ParaView
    streamlines: _Path | None
    #: Number of streamlines [default: 200]
    lines: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class EditOptions(TypedDict, total=False):
    #: Edits from a CSV file, one per line: add,X,Y,Z or move,N,X,Y,Z or remove,N
    edits: _Path | None
    #: Added and moved atoms only start where they are put, and then move as all others do; without
    #: this they stay there, as wells do
    free: bool | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ColumnsOptions(TypedDict, total=False):
    #: Number of layers between horizons: one for all, or N,N,... [default: 1]
    layers: _Value | None
    #: Mean thickness of the layers, instead of their number
    layer_thickness: _Number | None
    #: Layers thinner than this vanish there
    least_thickness: _Number | None
    #: Unit of z [default: that of the map's x]
    z_unit: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ExportOptions(TypedDict, total=False):
    #: Porosity: a number, a CSV file of lines region,porosity, a cell array of the mesh, or an
    #: image with an optional mean: FILE[:arithmetic|harmonic|geometric|nearest] [default mean:
    #: arithmetic]
    porosity: _Value | None
    #: Permeability: K or KX,KY,KZ along the mesh's coordinates, each a number or an image with an
    #: optional mean [default: geometric]; or a CSV file of lines region,K or region,KX,KY,KZ
    permeability: _Value | None
    #: Unit of the permeability: mD or m2
    permeability_unit: _Value | None
    #: Any other value for each cell, such as a seismic attribute, given in the same ways as a
    #: porosity; may be repeated
    property: _Values | None
    #: Regions of the cells from an image of labels
    region: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: How faults resist flow across them: closed, open, or the factor, from 0 to 1, of the
    #: permeability there [default: closed for flow, open for export]
    faults: _Value | None
    #: Thickness (m) of the layer to which the factor of --faults applies [default: from cell to
    #: cell]
    fault_thickness: _Number | None
    #: The factor of some surfaces: by the number or name that `atomesh surface MESH` prints, such
    #: as fault3:0.01, by the regions between which they lie, such as 1/11:0, or by a pattern of
    #: names with * and ?, such as 'interface_*_11:0'; may be repeated, and the last that picks a
    #: surface holds; or a CSV file of lines surface,factor[,thickness]
    fault_multiplier: _Values | None
    #: The surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    #: pairs of regions and patterns, as --fault-multiplier has them. Others are open [default:
    #: faults]
    barriers: _Value | None
    #: Columns along two axes, and layers, of a corner-point grid (grdecl) [default: as fine as the
    #: cells]
    grid: _Value | None
    #: Double the nodes along surfaces, with elements between their two sides (tetrahedra): faults,
    #: horizons, all, or a list of numbers and names as `atomesh surface MESH` prints them
    split: _Value | None
    #: Nodes in the middle of edges, too: elements of second order
    quadratic: bool | None
    #: Unit of the mesh's coordinates, whatever the mesh states: m, km, ft, cm, mm, um, nm. The
    #: export is in metres [default: what the mesh states, or m; scans in mm or less keep their
    #: unit where flow is not simulated]
    length_unit: _Value | None
    #: The coordinate that is depth, with its sign: -z if z grows upwards, z if downwards, x ...
    down: _Value | None
    #: Depth (m) of the mesh's shallowest point [default: by its coordinates]
    depth_at_top: _Number | None
    #: Velocity (m/s) that turns two-way time into depth
    velocity: _Number | None
    #: Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    thickness: _Number | None
    #: What fills the pores [default: water]
    fluid: Literal["water", "oil-water"] | None
    #: A well that injects water, in m^3/day, vertical in the cell at X,Y,Z (the mesh's
    #: coordinates), or along the trajectory in a CSV file of lines x,y,z,radius:
    #: [NAME=]FILE.csv:RATE; may be repeated
    injector: _Values | None
    #: A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a file; may
    #: be repeated
    producer: _Values | None
    #: Radius (m) of wells that are given by a point [default: 0.1]
    well_radius: _Number | None
    #: Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    pressure_at_top: _Number | None
    #: Fluids without weight (no hydrostatic gradient)
    no_gravity: bool | None
    #: Number of days to simulate [default: 3650]
    days: _Number | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class SliceOptions(TypedDict, total=False):
    #: Sections with the planes of samples, or what there is in space, a part of it taken away
    view: Literal["sections", "3d"] | None
    #: Paint cells with this array of the mesh, of cells or of nodes, such as pressure or region
    #: [default: the image]
    color: _Value | None
    #: The point where the planes meet, in physical coordinates [default: the middle]
    at: _Value | None
    #: What is taken away in --view 3d: the corner beyond that point, or all in front of the plane
    #: through it across x, y or z [default: corner]
    cut: Literal["corner", "x", "y", "z"] | None
    #: Which way is up: x, y, z or -x, -y, -z in physical coordinates [default: as the image has
    #: it; z where none is known]
    up: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class SurfaceOptions(TypedDict, total=False):
    #: Largest bend from face to face within a surface, in degrees
    max_bend: _Number | None
    #: Which way is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in 2-D]
    up: _Value | None
    #: What makes faces one surface
    by: Literal["bends", "regions"] | None
    #: Omit surfaces smaller than this, in square samples (length in 2-D); 0 keeps all [default:
    #: ten faces, and 2 % of the largest surface]
    min_area: _Number | None
    #: The surface that becomes a grid, by its number in the table [default: the only horizon]
    number: int | None
    #: Distance between sticks, or between the nodes of a grid, in the unit of x [default: ten
    #: sticks a fault; about the length of the surface's edges]
    step: _Number | None
    #: Show in the table which surfaces meet (--json always says it)
    meets: bool | None
    #: Depth of b(x), from 0 to 1, from which faces count as lying on the features of IMAGE
    #: [default: 0.6]
    depth: _Number | None
    #: The features of IMAGE [default: auto]
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential"] | None
    #: Scale of the features in samples [default: by the kind of feature]
    sigma: _Number | None
    #: Smallest strength of a feature, in units of the feature image [default: automatic, printed]
    threshold: _Number | None
    #: Makes depth in metres of two-way time: one velocity in m/s for the whole mesh, or a file of
    #: interval velocities in m/s on a grid of its own in two-way time
    velocity: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class PaintOptions(TypedDict, total=False):
    #: Paint stops this far from its seed, in samples, by the shortest way that crosses no surface
    level: _Number | None
    #: Openings narrower than this fraction of the blocks they join are cracks, through which paint
    #: does not pass; 0 for none
    neck: _Number | None
    #: The surfaces around the painted regions: .vtp, .obj, or GOCAD's .ts
    surface_out: _Path | None
    #: Largest bend from face to face within a surface, in degrees
    max_bend: _Number | None
    #: Which way is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in 2-D]
    up: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class SegmentOptions(TypedDict, total=False):
    #: The label of each sample, as an image
    labels_out: _Path | None
    #: The boundary between object and background, smoothed: .vtp, .obj, or GOCAD's .ts
    surface_out: _Path | None
    #: Weight of the values against the boundary
    lambda_: _Number | None
    #: Difference of neighbouring cells' values at which a boundary is cheap [default: the root
    #: mean square of all differences]
    sigma: _Number | None
    #: An image of the true object (not 0), with which the result is compared
    truth: _Path | None
    #: Also cut the image's samples themselves, the classical method, and report both
    voxels: bool | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: A bare array (.npy, raw, .tif, .png): distances between samples along its axes, the fastest
    #: first, or one for all
    spacing: _Value | None
    #: A bare array: the position of its first sample
    origin: _Value | None
    #: Units of x, y and z, or one for all, where the file has none: m, ft, ms, um ...
    unit: _Value | None
    #: A bare array: what its axes are, the fastest first: x, y, z (-z where the coordinate falls
    #: from sample to sample), or time, depth, sample (all downwards), crossline, inline [default:
    #: x,y,z]
    axes: _Value | None
    #: A bare array: it lies as this image of as many samples does (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without it,
    #: common ones are recognised, and traces that are zero throughout count as missing
    null: _Value | None
    #: SEG-Y: trace header byte of the inline number [default: 189]
    inline_byte: int | None
    #: SEG-Y: trace header byte of the crossline number [default: 193]
    crossline_byte: int | None
    #: SEG-Y: trace header byte of the x coordinate [default: 181]
    x_byte: int | None
    #: SEG-Y: trace header byte of the y coordinate [default: 185]
    y_byte: int | None
    #: SEG-Y: trace header byte of the coordinates' scale factor [default: 71]
    scalar_byte: int | None
    #: SEG-Y: trace header byte of the first sample's time in ms [default: 109]
    delay_byte: int | None
    #: SEG-Y: trace header byte of the sample interval in microseconds [default: 117]
    interval_byte: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class SynthOptions(TypedDict, total=False):
    #: Also write the exact distance to the features
    truth: _Path | None
    #: Also write how deep each sample was before folding and faulting (amplitude and network-
    #: amplitude): the same all along a reflector
    layers: _Path | None
    #: Number of samples along x, y and z; NX,NY makes a 2-D image
    dims: _Value | None
    #: Number of faults or shells (default: 4; of a network 2 to 6, as its seed says)
    count: int | None
    #: Signal over the rms of the noise; inf for none
    signal_to_noise: _Number | None
    #: Width of the features: the standard deviation of their profile, in samples
    width: _Number | None
    #: Seed of all random numbers
    rng_seed: int | None
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class DoctorOptions(TypedDict, total=False):
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class CompletionsOptions(TypedDict, total=False):
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None

class ManOptions(TypedDict, total=False):
    #: Memory that may be taken, e.g. 8G or 500M; what would take more is refused before it is
    #: begun [default: what is free]
    max_memory: int | None
