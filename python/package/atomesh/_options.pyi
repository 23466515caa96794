"""The options of every verb, as `stubs.py` writes them: what the command line declares."""

import os
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias, TypedDict

import numpy as np
import numpy.typing as npt

from ._image import Image

_Path: TypeAlias = str | os.PathLike[str]
_Number: TypeAlias = float | np.floating[Any] | np.integer[Any]
#: Words, numbers, points (x, y, z), pairs of numbers (a range), boxes of two points, files, and arrays or images in
#: place of files.
_Value: TypeAlias = (
    str | os.PathLike[str] | _Number | Sequence[_Number] | Sequence[Sequence[_Number]] | npt.NDArray[Any] | Image
)
#: One value or several. A dict holds pairs; what is requested of a label is a dict of its own.
_Values: TypeAlias = _Value | Sequence[_Value] | Mapping[Any, _Value | Mapping[str, _Value]]

class MeshOptions(TypedDict, total=False):
    #: Nominal distance between atoms, in samples: one number, or MIN:MAX; or in a unit of length,
    #: such as 3mm, 0.5mm:2mm or 40ft, if the image has one
    distance: _Value | None
    #: Source of a distance MIN:MAX: gaps (MAX, decreasing to MIN where features run close together
    #: or cross at shallow angles), features (MIN on them, increasing away from them), image (MIN
    #: where it is darkest, or brightest if bright features are followed), laplacian (of the
    #: potential), or a file with a distance for each sample
    distance_from: _Value | None
    #: How much work goes into the mesh: draft is for trying options out, best for the last mesh. A
    #: preset of other options, which override it [default: normal]
    effort: Literal["draft", "normal", "best"] | None
    #: The features to follow
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential", "none"] | None
    #: Faults and horizons to follow as they are, beside the features that are found (none with
    #: --feature none): FILE for all its surfaces, FILE:NAME for one, or to name the only one.
    #: GOCAD .ts and .pl, .vtp, .obj, grids (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), fault sticks
    #: and points x,y,z, which are brought to the image's coordinates. What the file does not say
    #: follows it: ,fault or ,horizon; ,unit=ft (of z) or ,unit=m,m,ft; ,z=up or ,z=down;
    #: ,domain=time or ,domain=depth; ,null=-999. May be repeated
    surface: _Values | None
    #: Continue faults of --surface that end within this distance of a side of the image or of
    #: another such fault, in samples or in a unit of length; 0 leaves them as they are [default:
    #: the distance between atoms]
    extend_faults: _Value | None
    #: Scale of the features, in samples [default: depends on the kind of feature]
    sigma: _Number | None
    #: Smooths the boundaries of labels over this many samples, also beyond the half sample that is
    #: allowed otherwise [default: as little as the steps of the samples ask for]
    label_smoothing: _Number | None
    #: Smallest strength of a feature, in units of the feature image; for an isosurface, its value,
    #: or several values in ascending order with commas between them, which divide the image into
    #: regions [default: automatic; it is printed]
    threshold: _Value | None
    #: How faults are recognised in seismic amplitudes
    fault_evidence: Literal["auto", "network", "semblance"] | None
    #: Smallest dip of a fault, in degrees; two-way time is converted to depth with --velocity, or
    #: else at 2,000 m/s
    min_dip: _Number | None
    #: Smallest size of a fault in samples, whatever the distance between atoms: its area is at
    #: least the square of it, in 2-D its length [default: 20]
    min_fault_size: _Number | None
    #: Smallest confidence of a fault or horizon in seismic amplitudes: leave out those below.
    #: Noise has up to 1
    min_confidence: _Number | None
    #: Seek faults and horizons in chaotic zones (salt, gas chimneys), too
    keep_chaos: bool | None
    #: Weights F,H of faults and horizons, each in (0, 1], if both are followed
    feature_weights: _Value | None
    #: Options of one label: VALUE:distance=D,name=NAME (distance between atoms in it, as for
    #: --distance), or VALUE:into=VALUE, which merges it into another label; may be repeated
    label: _Values | None
    #: Labels, by value or name, whose cells the mesh leaves out, such as 0 for the background.
    #: Their boundaries keep their names, such as interface_0_3
    drop: _Value | None
    #: Labels, by value or name, whose cells alone the mesh has
    keep: _Value | None
    #: Of each label that stays, keep only the largest connected part
    keep_largest: bool | None
    #: Number of samples below which a connected part of a label, or of a region of --feature
    #: isosurface, joins the labels around it before the image is meshed
    min_part: _Value | None
    #: A point of the object, in physical coordinates, for --feature paths; may be repeated
    object: _Values | None
    #: A point of the background, for --feature paths; may be repeated [default: the image's
    #: outermost samples]
    background: _Values | None
    #: Also write the potential b(x)
    potential_out: _Path | None
    #: Also write the lines where features, or a feature and a side of the box, meet at less than
    #: 30 degrees, with their angles
    lines: _Path | None
    #: Also write a page with mesh, image and figures: one HTML file for any browser
    page: _Path | None
    #: A folder in which the result of each stage is stored. The same command, started again after
    #: it was stopped, continues from there and makes the same mesh
    checkpoint: _Path | None
    #: Also write the faces on features with the number of their surface, as `atomesh surface` does
    surfaces: _Path | None
    #: Position of atoms: on features, or alongside them [default: on; alongside with --cells
    #: voronoi]
    align: Literal["on", "alongside"] | None
    #: Kind of cells [default: tets; voronoi with --align alongside]
    cells: Literal["tets", "voronoi"] | None
    #: Weight of the image against the lattice, in [0, 1): a number, or an image of weights
    beta: _Value | None
    #: Initial positions of atoms
    seeding: Literal["fcc", "grown", "refine", "canny", "guide", "projection"] | None
    #: Largest number of atoms that --seeding guide places [default: as many as fit]
    max_atoms: int | None
    #: A table of fixed atoms (wells, sources) with the columns x, y and z (x and y in 2-D), which
    #: are brought to the image's coordinates; what it does not say follows it, as for --surface
    atoms_from: _Value | None
    #: A table of well trajectories, along which atoms are fixed: columns x, y, z and radius (x, y
    #: and radius in 2-D), or a deviation survey; they are brought to the image's coordinates.
    #: FILE:NAME takes one well. What the file does not say follows it, as for --surface, and
    #: ,head=x,y,z is the wellhead; may be repeated
    well: _Values | None
    #: Distance between atoms at wells, in samples or in a unit of length; it increases to
    #: --distance away from them
    well_distance: _Value | None
    #: Evaluator of the lattice energy
    evaluator: Literal["pairwise", "sampled"] | None
    #: Weight, in [0, 1], of the energy between atoms against their Laplacian coordinates, which
    #: make the lattice more regular. 1 omits them, 0.7 is typical with them
    kappa: _Number | None
    #: Method that moves atoms
    optimizer: Literal["lbfgs", "descent", "genetic"] | None
    #: Largest number of rounds, each of which perturbs atoms at random and minimises the energy;
    #: they end when a round gains nothing [default: 1; 3 with --kappa]
    rounds: int | None
    #: Largest number of evaluations of the energy in all rounds together [default: 12 to 40 a
    #: round, more with --kappa and for slower optimisers]
    max_evaluations: _Value | None
    #: Number of initial passes on a smoother potential
    coarse_to_fine: int | None
    #: Target for the smallest dihedral angle, in degrees (in 2-D the smallest angle); the target
    #: for the largest is 180 minus it [default: 30; 15 with --effort draft]
    min_dihedral: _Number | None
    #: Method that removes slivers
    slivers: Literal["joe", "exude", "exude-cgal", "none"] | None
    #: Program that joins atoms to tetrahedra. The result does not depend on it
    delaunay: Literal["auto", "tetgen", "native"] | None
    #: Distance within which nodes of Voronoi cells are merged, as a fraction of the cells' radius,
    #: which removes the smallest faces
    weld: _Number | None
    #: Smooth the triangles of a 2-D image where it is flat; nodes on features do not move
    smooth: Literal["cvt", "odt"] | None
    #: Metric of lattice space: auto (shape for scans, for labels outside surveys, and for
    #: distances in a unit of length, else samples), samples, physical (--distance is then in
    #: physical units, not in samples), shape (physical proportions, with as many samples per cell
    #: as samples), k:KX,KY,KZ (cells for two-point fluxes in rock with these permeabilities along
    #: x, y and z; only their ratios count), or a scale per axis SX,SY,SZ (SX,SY in 2-D)
    metric: _Value | None
    #: The part of the image that the mesh covers: samples (the box through the outermost samples,
    #: N - 1 steps along an axis of N samples), or voxels (N steps; the outermost samples continue
    #: to the edges of their voxels)
    cover: Literal["samples", "voxels"] | None
    #: Continue the mesh beyond the image, with cells that coarsen away from it:
    #: above=DIST,below=DIST,sides=DIST in the image's physical units, of which any may be left
    #: out. The cells belong to the regions overburden, underburden and sideburden
    pad: _Value | None
    #: End the cells above the image at this surface, such as the ground or the seafloor: FILE or
    #: FILE:NAME, a grid of heights (IRAP, ZMAP+, CPS-3, Surfer, ESRI ASCII), GOCAD .ts, .vtp, .obj
    #: or points x,y,z, which are brought to the image's coordinates; what it does not say follows
    #: it, as for --surface. It must cover the image and the sides of --pad, and replaces
    #: above=DIST of --pad
    topography: _Value | None
    #: Make opposite sides match node by node along these axes, so that copies of the mesh fill
    #: space: x, y and z (x and y in 2-D). The last layer of the image along them must repeat the
    #: first
    periodic: _Value | None
    #: Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s
    #: for the whole image, or a file of interval velocities in m/s on a grid in two-way time. With
    #: a file, the image is resampled
    velocity: _Value | None
    #: Seed of all random numbers
    rng_seed: int | None
    #: Also write the report as JSON
    report: _Path | None
    #: Also write the lattice before atoms move and after each round or generation, for ParaView.
    #: The report then has the energy and the quality of each
    trace: _Path | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: A TOML file of options. Options on the command line take precedence
    config: _Path | None
    #: Print the whole report, which --report writes as JSON in any case
    details: bool | None
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class FeatureOptions(TypedDict, total=False):
    #: Also write the lines (in 2-D points) at which features cross, branch off one another and
    #: end, with the angle and the two feature surfaces: .vtp
    lines: _Path | None
    #: Also write the feature points with normal, strength and surface: .csv or .vtp
    points: _Path | None
    #: The features to find
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential", "none"] | None
    #: Nominal distance between atoms, in samples. The valleys of the potential are a quarter as
    #: wide
    distance: _Number | None
    #: Scale of the features, in samples [default: depends on the kind of feature]
    sigma: _Number | None
    #: Smallest strength of a feature, in units of the feature image; for an isosurface, its value,
    #: or several values in ascending order with commas between them [default: automatic; it is
    #: printed]
    threshold: _Value | None
    #: How faults are recognised in seismic amplitudes
    fault_evidence: Literal["auto", "network", "semblance"] | None
    #: Smallest dip of a fault, in degrees; two-way time is converted to depth at 2,000 m/s
    min_dip: _Number | None
    #: Smallest size of a fault in samples, whatever the distance between atoms: its area is at
    #: least the square of it, in 2-D its length [default: 20]
    min_fault_size: _Number | None
    #: Seek faults and horizons in chaotic zones (salt, gas chimneys), too
    keep_chaos: bool | None
    #: Weights F,H of faults and horizons, each in (0, 1], if both are followed
    feature_weights: _Value | None
    #: A point of the object, in physical coordinates, for --feature paths; may be repeated
    object: _Values | None
    #: A point of the background, for --feature paths; may be repeated [default: the image's
    #: outermost samples]
    background: _Values | None
    #: Also write the fraction of paths that passes through each sample, for --feature paths: .vti,
    #: .npy, .nrrd, .mha, .nii or .png
    confidence_out: _Path | None
    #: Seed of the random numbers, for --feature paths
    rng_seed: int | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class InfoOptions(TypedDict, total=False):
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ConvertOptions(TypedDict, total=False):
    #: Convert an image from two-way time to depth (in the unit of x and y, m or ft), with one
    #: velocity in m/s or a file of interval velocities in m/s. Such a file is a grid in two-way
    #: time, and the image is resampled
    velocity: _Value | None
    #: Write SEG-Y (OUT.sgy) with the headers of this survey, which has as many samples: its text,
    #: lines, coordinates and order of traces
    like: _Path | None
    #: The samples of SEG-Y that is written: ibm or ieee floats [default: as in the survey]
    sample_format: _Value | None
    #: Write the names of labels that the image or its table has (--label-table): NAMES.csv or
    #: .tsv, which atomesh mesh --label-table reads
    label_table_out: _Path | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class QualityOptions(TypedDict, total=False):
    #: The exact distance to the features, as `synth --truth` writes it
    truth: _Path | None
    #: The image of labels that was meshed: also compare the mesh with each connected part of its
    #: labels, sample by sample
    labels: _Path | None
    #: Also write the lines where features, or a feature and a side of the box, meet at less than
    #: 30 degrees, with their angles
    lines: _Path | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ReportOptions(TypedDict, total=False):
    #: The file that mesh --report has written, for its fidelity, notes and cost [default: figures
    #: are measured from the mesh]
    figures: _Path | None
    #: Heading of the page [default: the mesh's name]
    title: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ValidateOptions(TypedDict, total=False):
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class FlowOptions(TypedDict, total=False):
    #: Pressure (Pa) on a side of the box: xmin, xmax, ymin ... along the image's axes, x the
    #: fastest in memory. Sides without a pressure are closed
    pressure: _Values | None
    #: Resistance of faults to flow: closed, open, or a factor by which the permeability is
    #: multiplied there, from 0 to 1, in an export also above 1 [default: closed for flow, open for
    #: export]
    faults: _Value | None
    #: Thickness (m) of the layer to which the factor of --faults applies [default: the distance
    #: between the two cells]
    fault_thickness: _Number | None
    #: Factor of some surfaces: their number or name as `atomesh surface MESH` prints it
    #: (fault3:0.01), the two regions that they separate (1/11:0), or a pattern with * and ?
    #: ('interface_*_11:0'). May be repeated, and the last match applies; or a CSV file of lines
    #: surface,factor or surface,factor,thickness
    fault_multiplier: _Values | None
    #: Surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    #: pairs of regions and patterns as in --fault-multiplier. All others are open [default:
    #: faults]
    barriers: _Value | None
    #: Extend faults beyond their edges by up to DIST metres, to the next fault or the sides of the
    #: mesh, along the faces of cells. An extension has a name of its own, such as
    #: fault1_extension, and the law of its fault
    extend_faults: _Number | None
    #: Permeability in m^2 (1 mD is 9.87e-16 m^2): K; KX,KY,KZ; KXX,KYY,KZZ,KXY,KYZ,KXZ (in 2-D K;
    #: KX,KY; KXX,KYY,KXY); a CSV file of lines region,K; or a cell array of the mesh
    permeability: _Value | None
    #: Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s or
    #: a file of interval velocities in m/s on a grid in two-way time. Sources and sinks are then
    #: in depth
    velocity: _Value | None
    #: Viscosity in Pa s
    viscosity: _Number | None
    #: Also write streamlines that carry equal rates, for ParaView
    streamlines: _Path | None
    #: Number of streamlines [default: 200]
    lines: int | None
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class EditOptions(TypedDict, total=False):
    #: A CSV file of edits, one per line: add,X,Y,Z or move,N,X,Y,Z or remove,N
    edits: _Path | None
    #: Let added and moved atoms move like all others. By default they stay in place, as wells do
    free: bool | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ColumnsOptions(TypedDict, total=False):
    #: Number of layers between two horizons: one number for all intervals, or N,N,... [default: 1]
    layers: _Value | None
    #: Mean thickness of the layers; replaces --layers
    layer_thickness: _Number | None
    #: Smallest thickness of a layer; thinner layers vanish at that place
    least_thickness: _Number | None
    #: Let horizons be offset at the map's faults: z closer than DIST to a fault is continued from
    #: the same side
    throws: _Number | None
    #: Unit of z [default: the unit of the map's x]
    z_unit: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ExportOptions(TypedDict, total=False):
    #: Porosity: a number, a CSV file of lines region,porosity, a cell array of the mesh, or an
    #: image with an optional mean: FILE[:arithmetic|harmonic|geometric|nearest] [default mean:
    #: arithmetic]
    porosity: _Value | None
    #: Permeability: K, or KX,KY,KZ along the mesh's coordinates, each a number or an image with an
    #: optional mean [default: geometric]; or a CSV file of lines region,K or region,KX,KY,KZ
    permeability: _Value | None
    #: Unit of the permeability: mD or m2
    permeability_unit: _Value | None
    #: Net-to-gross ratio, given like a porosity: the part of a cell's height that is reservoir
    #: rock. It reduces pore volumes and the permeability along x and y
    net_to_gross: _Value | None
    #: A lower limit below which cells are inactive: of porosity, permeability (the largest along
    #: an axis, in its unit), net-to-gross, or a --property; may be repeated
    cutoff: _Values | None
    #: Numbers of the cells' tables of relative permeability and capillary pressure: a CSV file of
    #: lines region,number, a cell array of the mesh, an image, or a number
    satnum: _Value | None
    #: Numbers of the cells' tables of fluid volumes, given like --satnum
    pvtnum: _Value | None
    #: Numbers of the cells' equilibration regions, which have contacts of their own, given like
    #: --satnum
    eqlnum: _Value | None
    #: Numbers of the regions for which fluids in place are reported, given like --satnum [default:
    #: the regions]
    fipnum: _Value | None
    #: Another property of the cells, such as a seismic attribute, given like a porosity; may be
    #: repeated
    property: _Values | None
    #: An image of labels that sets the regions of the cells: each cell has the label that fills
    #: the largest part of it, or with `:nearest` at the end that at its centre
    region: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Resistance of faults to flow: closed, open, or a factor by which the permeability is
    #: multiplied there, from 0 to 1, in an export also above 1 [default: closed for flow, open for
    #: export]
    faults: _Value | None
    #: Thickness (m) of the layer to which the factor of --faults applies [default: the distance
    #: between the two cells]
    fault_thickness: _Number | None
    #: Factor of some surfaces: their number or name as `atomesh surface MESH` prints it
    #: (fault3:0.01), the two regions that they separate (1/11:0), or a pattern with * and ?
    #: ('interface_*_11:0'). May be repeated, and the last match applies; or a CSV file of lines
    #: surface,factor or surface,factor,thickness
    fault_multiplier: _Values | None
    #: Surfaces to which --faults applies: faults, horizons, all, or a list of numbers, names,
    #: pairs of regions and patterns as in --fault-multiplier. All others are open [default:
    #: faults]
    barriers: _Value | None
    #: Throw (m) of faults, whose fault rock then follows from --clay: their number or name, or a
    #: pattern (fault3:25), negative for reverse faults; a CSV file of lines surface,throw; or the
    #: surfaces with throws that `atomesh surface MESH --survey IMAGE -o FILE.vtp` writes, for the
    #: throw of each face. May be repeated, and the last match applies
    throw: _Values | None
    #: Clay fraction of the rock, 0 to 1, given like a porosity: with --throw it gives the shale-
    #: gouge ratio, the permeability and the thickness of fault rock
    clay: _Value | None
    #: Law of the permeability of fault rock: manzocchi, or sperrevik:MAX,FAULTING with the largest
    #: depth of burial and the depth of faulting in metres [default: manzocchi]
    fault_rock: _Value | None
    #: Take beds with a clay fraction of 0.4 or more as smeared along the fault where the throw is
    #: below FACTOR times their thickness: the fault rock there has their clay. 7 is usual
    clay_smear: _Number | None
    #: Regions, by label or name, whose cells are left out, such as 0 for the background. Their
    #: boundaries keep their names, such as interface_0_3
    drop: _Value | None
    #: Regions, by label or name, whose cells alone are exported
    keep: _Value | None
    #: Of each region that stays, keep only the largest connected part
    keep_largest: bool | None
    #: Number of columns along two axes, and of layers, of a corner-point grid (grdecl) [default:
    #: as fine as the cells]
    grid: _Value | None
    #: Duplicate the nodes along surfaces and add elements between the two sides (tetrahedra only):
    #: faults, horizons, all, or a list of numbers and names as `atomesh surface MESH` prints them
    split: _Value | None
    #: Add nodes in the middle of edges: elements of second order
    quadratic: bool | None
    #: Extend faults beyond their edges by up to DIST metres, to the next fault or the sides of the
    #: mesh, along the faces of cells. An extension has a name of its own, such as
    #: fault1_extension, and the law of its fault
    extend_faults: _Number | None
    #: Also write what lies against what on the two sides of faults (Allan maps): a table of area,
    #: throw, shale-gouge ratio, multiplier and transmissibility by pairs of zones (.csv), the
    #: faces with these (.vtp), or a picture (.png). May be repeated
    juxtaposition: _Values | None
    #: Report for each closed fault whether it seals, the share of the flow between its two sides
    #: that passes through it and around its ends, the place, area, cause and remedy of each leak,
    #: and the wells in each compartment
    check_seals: bool | None
    #: Write the result of --check-seals as a table, a line for each leak (.csv)
    seal_table: _Path | None
    #: Unit of the mesh's coordinates, if it is not the one that the mesh states: m, km, ft, cm,
    #: mm, um or nm. The export is in metres [default: what the mesh states, or m; scans in mm or
    #: less keep their unit where flow is not simulated]
    length_unit: _Value | None
    #: The coordinate that is depth, with its sign: -z if z grows upwards, z if it grows downwards,
    #: x ...
    down: _Value | None
    #: Depth (m) of the mesh's shallowest point [default: from its coordinates]
    depth_at_top: _Number | None
    #: Velocity (m/s) that converts two-way time to depth
    velocity: _Number | None
    #: Thickness of a 2-D mesh, in the unit of its coordinates [default: 1]
    thickness: _Number | None
    #: Fluids in the pores [default: water]
    fluid: Literal["water", "oil-water", "oil-water-gas"] | None
    #: A well that injects water at a rate in m^3/day. It is vertical in the cell at X,Y,Z (the
    #: mesh's coordinates), or follows the trajectory in a table of columns x, y, z and radius:
    #: [NAME=]FILE.csv:RATE; may be repeated
    injector: _Values | None
    #: A well that produces at a pressure in bar, at X,Y,Z or along the trajectory in a CSV file;
    #: may be repeated
    producer: _Values | None
    #: A well whose rates and pressures are in --schedule, at X,Y,Z or along the trajectory in a
    #: CSV file; may be repeated
    well: _Values | None
    #: A CSV table of what wells and groups do, with a row of names at the top: date, well, group,
    #: type, status, mode, control, oil, water, gas, liquid, reservoir, bhp, skin
    schedule: _Path | None
    #: First day of the simulation, year-month-day [default: the first date of the schedule, or
    #: 2000-01-01]
    start: _Value | None
    #: Depth (m) of a contact between fluids, which are in equilibrium at the start: oil-
    #: water=DEPTH or gas-oil=DEPTH, perhaps with the capillary pressure there (bar), and before it
    #: the number of an equilibration region: 2/oil-water=2450:0.1; may be repeated
    contact: _Values | None
    #: Initial pressure (bar) at a depth (m) where there are contacts; may be repeated [default:
    #: that of a column of water at the contact with oil]
    datum: _Values | None
    #: Capillary pressure between oil and water after Brooks and Corey: entry pressure (bar) and
    #: exponent, for all or one of the tables of --satnum; may be repeated [default: none; exponent
    #: 2]
    capillary_pressure: _Values | None
    #: An aquifer beyond a side of the mesh (xmin ... zmax): Carter-Tracy with permeability (mD),
    #: porosity, thickness (m), radius (m) and angle (degrees), or Fetkovich with volume (m^3) and
    #: productivity (m^3/day/bar); both with compressibility (1/bar), below (depth), datum and
    #: pressure; may be repeated
    aquifer: _Values | None
    #: Radius (m) of wells that are given by a point, or whose file has no radius [default: 0.1]
    well_radius: _Number | None
    #: Initial pressure (bar) at the top [default: hydrostatic from 1.01325 at depth 0]
    pressure_at_top: _Number | None
    #: Ignore gravity: no hydrostatic gradient
    no_gravity: bool | None
    #: Number of days to simulate [default: 3650]
    days: _Number | None
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class SliceOptions(TypedDict, total=False):
    #: The view: sections with three planes, or a view in space of which a part is cut away
    view: Literal["sections", "3d"] | None
    #: Array of the mesh, of cells or of nodes, that colours the cells, such as pressure or region
    #: [default: the image]
    color: _Value | None
    #: The point where the planes meet, in physical coordinates; of a survey, also lines, such as
    #: inline=2047, or inline=2047,crossline=310,z=-900 [default: the middle]
    at: _Value | None
    #: The part that is cut away in --view 3d: the corner beyond that point, or all in front of the
    #: plane through it across x, y or z [default: corner]
    cut: Literal["corner", "x", "y", "z"] | None
    #: The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: as the
    #: image has it; z if unknown]
    up: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class SurfaceOptions(TypedDict, total=False):
    #: Largest bend from face to face within a surface, in degrees
    max_bend: _Number | None
    #: The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in
    #: 2-D]
    up: _Value | None
    #: The criterion by which faces form a surface
    by: Literal["bends", "regions"] | None
    #: Smallest area of a surface, in square samples (length in 2-D); smaller ones are omitted, and
    #: 0 keeps all [default: ten faces, and 2 % of the largest surface]
    min_area: _Number | None
    #: The number of the surface that becomes a grid or points, as in the printed table [default:
    #: all horizons, with a file each]
    number: int | None
    #: Distance between sticks, or between the nodes of a grid, in the unit of x [default: ten
    #: sticks per fault; for a grid the bins of the survey, or about the length of the surface's
    #: edges]
    step: _Number | None
    #: Surfaces of an earlier interpretation, whose names the surfaces at the same place get: .vtp,
    #: .ts, .obj, grids, sticks or points, and what the file does not say, as for mesh --surface.
    #: All other surfaces get numbers that no earlier name has
    names_from: _Value | None
    #: Also write the mesh with the names of these surfaces, which every verb then uses
    mesh_out: _Path | None
    #: Show in the table which surfaces meet (--json always does)
    meets: bool | None
    #: The image of amplitudes that was meshed. It gives throw of faults, polarity of horizons, and
    #: confidence; its lines number points, and its bins are the nodes of grids
    survey: _Path | None
    #: Smallest confidence of a fault or horizon in the survey: omit those below. Noise has about 1
    min_confidence: _Number | None
    #: Depth of the valleys of b(x), from 0 to 1, from which faces count as lying on the features
    #: of IMAGE [default: 0.6]
    depth: _Number | None
    #: The features to detect in IMAGE [default: auto]
    feature: Literal["auto", "ridges", "valleys", "edges", "canny", "isosurface", "paths", "horizons", "faults", "faults+horizons", "labels", "mask", "potential", "none"] | None
    #: Scale of the features, in samples [default: depends on the kind of feature]
    sigma: _Number | None
    #: Smallest strength of a feature, in units of the feature image; for an isosurface, its value,
    #: or several values in ascending order with commas between them [default: automatic; it is
    #: printed]
    threshold: _Value | None
    #: Convert two-way time to depth (in the unit of x and y, m or ft), with one velocity in m/s
    #: for the whole mesh, or a file of interval velocities in m/s on a grid in two-way time
    velocity: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class PaintOptions(TypedDict, total=False):
    #: Largest distance of paint from its seed, in samples, along the shortest path that crosses no
    #: surface
    level: _Number | None
    #: Largest width of an opening that paint does not pass, as a fraction of the blocks that it
    #: connects; 0 for none
    neck: _Number | None
    #: Also write the surfaces around the painted regions: .vtp, .obj, or GOCAD's .ts
    surface_out: _Path | None
    #: Largest bend from face to face within a surface, in degrees
    max_bend: _Number | None
    #: The direction that is up: x, y, z or -x, -y, -z in physical coordinates [default: z; y in
    #: 2-D]
    up: _Value | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class SegmentOptions(TypedDict, total=False):
    #: Also write the label of each sample as an image
    labels_out: _Path | None
    #: Also write the boundary between object and background, smoothed: .vtp, .obj, or GOCAD's .ts
    surface_out: _Path | None
    #: Weight of the image values against the boundary
    lambda_: _Number | None
    #: Difference of neighbouring cells' values at which a boundary is cheap [default: the root
    #: mean square of all differences]
    sigma: _Number | None
    #: An image of the true object (not 0), to be compared with the result
    truth: _Path | None
    #: Also cut the image's samples themselves, which is the classical method, and report both
    voxels: bool | None
    #: The file holds raw samples: NXxNYxNZ:TYPE (NXxNY:TYPE in 2-D), x fastest, e.g.
    #: 100x400x208:f32be
    raw: _Value | None
    #: Distances between samples along the axes of the array, the fastest first, or one for all:
    #: for an array without geometry (.npy, raw, .tif, .png), in place of those of the file, or of
    #: the lattice on which a corner-point grid is sampled
    spacing: _Value | None
    #: The position of the first sample
    origin: _Value | None
    #: Units of x, y and z (in this order, whatever the axes are), or one for all, such as m, ft,
    #: ms, um. They replace those of the file; numbers are not converted
    unit: _Value | None
    #: The axes of the array, the fastest first: x, y, z (-z where the coordinate decreases from
    #: sample to sample), or time, depth, sample (all downwards), crossline, inline [default: those
    #: of the file, or x,y,z]
    axes: _Value | None
    #: Distance between samples along the vertical axis (time, depth or z), in its unit, in place
    #: of that of the file
    interval: _Number | None
    #: Take the geometry of this image, which has as many samples (.sgy, .vti ...)
    geometry_from: _Path | None
    #: Values that stand for missing samples, e.g. -999.25,1e30; none: no value does. Without this
    #: option common null values are recognised, and traces that are zero throughout count as
    #: missing
    null: _Value | None
    #: An image with as many samples, such as labels of salt or gas: where it is not 0, samples are
    #: left out, and neither they nor their edge are features
    mask: _Path | None
    #: The block of the image to read, both ends included: ranges of line numbers, of coordinates
    #: or of indices from 0, separated by commas, such as inline=100:200,time=1000:1500,
    #: x=A:B,y=A:B,z=A:B or i=A:B. Everything is as if the file held only this block
    crop: _Value | None
    #: Leave out what lies outside: a polygon in map view (a table of x,y, a closed line .pl or
    #: .vtp), or an image with as many samples that is 0 outside
    inside: _Path | None
    #: A segmentation of 3D Slicer (.seg.nrrd) or of DICOM whose segments overlap: the number of
    #: the layer to read, from 0
    layer: int | None
    #: Names of the labels of the image: a table of ITK-SNAP, FreeSurfer or 3D Slicer, or one of
    #: values and names (.csv, .tsv). none: not those of a table that lies beside the image
    label_table: _Path | None
    #: SEG-Y: time or depth, in which the samples are [default: time, or depth if the textual
    #: header says so]. In depth, sample intervals are in thousandths of a metre or foot, and the
    #: first sample in metres or feet
    domain: Literal["time", "depth"] | None
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
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class SynthOptions(TypedDict, total=False):
    #: Also write the exact distance to the features
    truth: _Path | None
    #: Also write the depth of each sample before folding and faulting, which is constant along a
    #: reflector (amplitude and network-amplitude)
    layers: _Path | None
    #: Number of samples along x, y and z; NX,NY makes a 2-D image
    dims: _Value | None
    #: Number of faults or shells [default: 4; for a network 2 to 6, from its seed]
    count: int | None
    #: Ratio of the signal to the rms of the noise; inf for no noise
    signal_to_noise: _Number | None
    #: Standard deviation of the features' profile, in samples
    width: _Number | None
    #: Seed of all random numbers
    rng_seed: int | None
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ScriptOptions(TypedDict, total=False):
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class DoctorOptions(TypedDict, total=False):
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class CompletionsOptions(TypedDict, total=False):
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None

class ManOptions(TypedDict, total=False):
    #: Largest memory to use, such as 8G or 500M. A job that would need more is refused before it
    #: begins [default: the free memory]
    max_memory: int | None
