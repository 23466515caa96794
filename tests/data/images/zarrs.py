"""Compares arrays of zarr-python in every type, codec and layout with those that `atomesh convert` reads, and checks
that zarr-python and xarray read what `atomesh convert` writes.

    zarrs.py ATOMESH FOLDER

Prints the numbers of stores read and written, and one line for each difference. The exit code is 1 if there is a
difference."""

import itertools
import json
import os
import subprocess
import sys

import numpy as np
import xarray
import zarr
from zarr.codecs import BloscCodec, Crc32cCodec, GzipCodec, TransposeCodec, ZstdCodec

atomesh, folder = sys.argv[1:]
os.chdir(folder)
rng = np.random.default_rng(5)
faults, read, written = [], 0, 0
SHAPE = (13, 10, 17)


def values(dtype, shape=SHAPE):
    """Returns smooth values with some noise, which compress well but not completely."""
    dtype = np.dtype(dtype)
    wave = 50 + 40 * np.sin(np.arange(np.prod(shape)) / 9).reshape(shape) + rng.integers(0, 5, shape)
    return (wave > 50) if dtype == bool else wave.astype(dtype)


def run(*words):
    return subprocess.run([atomesh, *words], capture_output=True, text=True)


def compare(name, array, path=None):
    global read
    result = run("convert", path or name, "out.npy", "--quiet")
    if result.returncode:
        faults.append(f"{name}: refused: {result.stderr.strip()}")
        return
    read += 1
    ours, theirs = np.load("out.npy"), np.asarray(array).astype(np.float32)
    if ours.shape != theirs.shape or not np.array_equal(ours, theirs, equal_nan=True):
        faults.append(f"{name}: {ours.shape} {theirs.shape} values differ")


def write(name, array, **options):
    options.setdefault("chunks", (5, 4, 8))
    store = zarr.create_array(name, shape=array.shape, dtype=array.dtype, overwrite=True, **options)
    store[...] = array
    return store


types = ["bool", "i1", "u1", "<i2", "<u2", "<i4", "<u4", "<i8", "<u8", "<f2", "<f4", "<f8"]
for number, dtype in enumerate(types):
    array = values(dtype)
    write(f"t{number}.zarr", array)
    compare(f"t{number}.zarr", array)
    if np.dtype(dtype).itemsize > 1:
        serializer = zarr.codecs.BytesCodec(endian="big")
        write(f"b{number}.zarr", array, serializer=serializer)
        compare(f"b{number}.zarr", array)

# Blosc with each of its compressors and shuffles, in one block and in several.
large = values("f4", (60, 50, 40))
small = values("i2", (6, 7, 5))
for number, (cname, shuffle, level) in enumerate(itertools.product(
        ["lz4", "lz4hc", "blosclz", "zlib", "zstd"], ["noshuffle", "shuffle", "bitshuffle"], [1, 9])):
    codec = BloscCodec(cname=cname, shuffle=shuffle, clevel=level)
    for array, chunks in ((large, (60, 50, 40)), (small, (3, 7, 5))):
        if array is large and level == 1 and shuffle != "shuffle":
            continue
        name = f"blosc{number}{array.dtype}.zarr"
        write(name, array, chunks=chunks, compressors=[codec])
        compare(name, array)
noise = rng.integers(0, 1 << 30, SHAPE).astype("u4")
write("noise.zarr", noise, compressors=[BloscCodec()])
compare("noise.zarr", noise)

array = values("f4")
chains = {
    "none": dict(compressors=None),
    "zstd": dict(compressors=[ZstdCodec(level=3, checksum=True)]),
    "zstd19": dict(compressors=[ZstdCodec(level=19)]),
    "gzip": dict(compressors=[GzipCodec(level=6)]),
    "sums": dict(compressors=[Crc32cCodec()]),
    "both": dict(compressors=[GzipCodec(level=1), Crc32cCodec()]),
    "turned": dict(filters=[TransposeCodec(order=(2, 0, 1))], compressors=[ZstdCodec()]),
    "twice": dict(filters=[TransposeCodec(order=(2, 0, 1)), TransposeCodec(order=(1, 0, 2))]),
    "dots": dict(chunk_key_encoding={"name": "default", "separator": "."}),
    "keys2": dict(chunk_key_encoding={"name": "v2", "separator": "."}),
    "shards": dict(shards=(10, 8, 16)),
    "shards_zstd": dict(shards=(10, 8, 16), compressors=[ZstdCodec()], filters=[TransposeCodec(order=(1, 2, 0))]),
    "whole": dict(chunks=SHAPE),
    "thin": dict(chunks=(1, 10, 17)),
}
for name, options in chains.items():
    write(f"{name}.zarr", array, **options)
    compare(f"{name}.zarr", array)

# Missing chunks, alone and within shards.
for name, fill, options in (("gaps", 7.5, {}), ("nans", np.nan, {}), ("holes", -1.0, dict(shards=(10, 8, 16)))):
    store = zarr.create_array(f"{name}.zarr", shape=SHAPE, dtype="f4", chunks=(5, 4, 8), fill_value=fill, **options)
    store[5:10, 4:8] = array[5:10, 4:8]
    compare(f"{name}.zarr", store[...])

# A 2-D array, a group, an additional axis of length one, and coordinates of xarray.
plane = values("u2", (30, 20))
write("plane.zarr", plane, chunks=(8, 8))
compare("plane.zarr", plane)
write("four.zarr", array[None], chunks=(1, 5, 4, 8))
compare("four.zarr", array)
group = zarr.create_group("group.zarr")
for name in ("a", "b"):
    group.create_array(name, data=array)
compare("group.zarr/b", array)
several = run("info", "group.zarr")
if several.returncode != 1 or "several arrays: a (13 x 10 x 17), b" not in several.stderr:
    faults.append(f"group.zarr: {several.stderr}")
coordinates = {"z": 100 + 2.0 * np.arange(13), "y": 5.0 - 3 * np.arange(10), "x": ("x", 4.0 * np.arange(17), {"units": "m"})}
data = xarray.Dataset({"density": (("z", "y", "x"), array)}, coords=coordinates)
data.to_zarr("xarray.zarr", zarr_format=3, consolidated=False)
compare("xarray.zarr", array)
image = json.loads(run("info", "xarray.zarr", "--json").stdout)["image"]
steps = [axis["step"] for axis in image["axes"]]
if image["origin"] != [0, 5, 100] or steps != [[4, 0, 0], [0, -3, 0], [0, 0, 2]] or image["units"][0] != "m":
    faults.append(f"xarray.zarr lies at {image}")
# Version 2, with its codecs, orders and separators.
from numcodecs import LZ4, Blosc, GZip, Zlib, Zstd

for number, (codec, order, separator) in enumerate(itertools.product(
        (None, Blosc(), Blosc("zstd", shuffle=Blosc.BITSHUFFLE), Zlib(), GZip(), Zstd(), LZ4()), "CF", "./")):
    for dtype in ("<i2", ">f4", "u1", "<f8"):
        name = f"old{number}{dtype[1:]}.zarr"
        array = values(dtype)
        options = {"compressors": codec, "order": order, "chunk_key_encoding": {"name": "v2", "separator": separator}}
        store = zarr.create_array(name, shape=SHAPE, dtype=dtype, chunks=(5, 4, 8), zarr_format=2, **options)
        store[...] = array
        compare(name, array)
array = values("f4")

# Stores that atomesh writes, of every type that it keeps, of small and large images.
for dtype, shape in itertools.product(["u1", "i2", "f2", "f4", "f8", "bool"], [(13, 10, 17), (70, 65, 130), (9, 70)]):
    array = values(dtype, shape)
    np.save("in.npy", array)
    result = run("convert", "in.npy", "out.zarr", "--quiet", "--spacing", "2")
    if result.returncode:
        faults.append(f"writing {dtype} {shape}: {result.stderr}")
        continue
    written += 1
    theirs = zarr.open("out.zarr")["samples"]
    expected_type = np.float32 if dtype == "f8" or len(shape) == 2 else np.dtype(dtype)
    if theirs.dtype != expected_type or not np.array_equal(theirs[...], array.astype(expected_type)):
        faults.append(f"writing {dtype} {shape}: read as {theirs}")
    data = xarray.open_zarr("out.zarr", consolidated=False)
    if data.samples.dims != ("z", "y", "x")[-len(shape):] or data.x.values[1] != 2:
        faults.append(f"writing {dtype} {shape}: xarray has {data}")
    compare("again", array, "out.zarr")

print(f"zarr-python: {read} read, {written} written")
print("\n".join(faults))
sys.exit(bool(faults))
