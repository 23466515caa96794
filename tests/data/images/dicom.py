"""Compares the DICOM files of pydicom's test data with pydicom: `atomesh convert` must read the same values, and
`atomesh info` the position of the first sample that the file gives.

    dicom.py ATOMESH FOLDER [FILES]

Each file lies alone in a folder. Prints one line for each refusal and one for each difference. The exit code is 1 if there is
a difference."""

import glob
import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pydicom
from pydicom.pixels import apply_rescale

atomesh, folder, *patterns = sys.argv[1:]
os.makedirs(folder, exist_ok=True)
os.chdir(folder)
test_data = os.path.join(os.path.dirname(pydicom.__file__), "data/test_files")
patterns = patterns or [f"{test_data}/*.dcm", f"{test_data}/dicomdirtests/**/*"]
files = sorted(path for pattern in patterns for path in glob.glob(pattern, recursive=True) if os.path.isfile(path))
same, refused, unread, faults = 0, {}, 0, []


def run(*words):
    return subprocess.run([atomesh, *words], capture_output=True, text=True)


def frame_values(data):
    """Returns the values of each frame, x fastest, with NaN for padding, and the frames' positions."""
    stored = data.pixel_array
    count = int(data.get("NumberOfFrames", 1) or 1)
    frames = stored.reshape(count, *stored.shape[-2:])
    mask = (1 << data.BitsStored) - 1 if "PixelData" in data else None
    values, positions = [], []
    for number, frame in enumerate(frames):
        whole = frame.astype(np.float64)
        groups = data.get("PerFrameFunctionalGroupsSequence")
        shared = data.get("SharedFunctionalGroupsSequence")
        sources = [data, *([shared[0]] if shared else []), *([groups[number]] if groups else [])]
        slope, intercept, position = 1.0, 0.0, None
        for source in sources:
            item = source.get("PixelValueTransformationSequence")
            item = item[0] if item else source
            slope = float(item.get("RescaleSlope", slope))
            intercept = float(item.get("RescaleIntercept", intercept))
            item = source.get("PlanePositionSequence")
            item = item[0] if item else source
            position = item.get("ImagePositionPatient", position)
        if data.get("ModalityLUTSequence"):
            out = apply_rescale(frame, data).astype(np.float64)
        elif "DoseGridScaling" in data:
            out = whole * float(data.DoseGridScaling)
        else:
            out = whole * slope + intercept
        if "PixelPaddingValue" in data and "SegmentSequence" not in data:
            padding = int(data.PixelPaddingValue)
            limit = int(data.get("PixelPaddingRangeLimit", padding) or padding)
            out[(whole >= min(padding, limit)) & (whole <= max(padding, limit))] = np.nan
        values.append(out)
        positions.append(position)
    assert mask is None or mask > 0
    return np.array(values), positions


for path in files:
    shutil.rmtree("one", ignore_errors=True)
    os.makedirs("one")
    target = os.path.join("one", os.path.basename(path))
    shutil.copy(path, target)
    name = os.path.relpath(path, test_data)
    if os.path.exists("out.npy"):
        os.remove("out.npy")
    result = run("convert", target, "out.npy", "--quiet")
    if result.returncode:
        message = result.stderr.strip()
        if result.returncode != 1 or len(message.splitlines()) != 1:
            faults.append(f"{name}: exit code {result.returncode}: {message}")
        problem = message.split(": ", 2)[-1]
        refused.setdefault(problem[:100], []).append(name)
        continue
    try:
        data = pydicom.dcmread(path)
        values, positions = frame_values(data)
    except Exception as error:
        unread += 1
        print(f"pydicom cannot read {name}: {error}"[:160])
        continue
    ours = np.load("out.npy")
    ours = ours.reshape(-1, *ours.shape[-2:])
    if ours.shape != values.shape:
        faults.append(f"{name}: shape {ours.shape}, theirs {values.shape}")
        continue
    order = list(range(len(values)))
    if all(p is not None for p in positions):
        frame = data
        orientation = data.get("ImageOrientationPatient")
        for group in ("SharedFunctionalGroupsSequence", "PerFrameFunctionalGroupsSequence"):
            if data.get(group) and data[group][0].get("PlaneOrientationSequence"):
                orientation = data[group][0].PlaneOrientationSequence[0].ImageOrientationPatient
        if orientation is not None and len({tuple(map(float, p)) for p in positions}) > 1:
            normal = np.cross(orientation[:3], orientation[3:])
            order.sort(key=lambda n: float(np.dot(normal, np.array(positions[n], float))))
        image = json.loads(run("info", target, "--json").stdout)
        first = image["image"]["origin"]
        if len(first) == 3 and np.abs(np.array(positions[order[0]], float) - first).max() > 1e-3:
            faults.append(f"{name}: first sample at {first}, theirs {positions[order[0]]}")
    theirs = values[order].astype(np.float32)
    equal = (ours == theirs) | (np.isnan(ours) & np.isnan(theirs))
    if not equal.all():
        where = np.argwhere(~equal)[0]
        faults.append(
            f"{name}: {(~equal).sum()} samples differ, at {where}: {ours[tuple(where)]}, theirs {theirs[tuple(where)]} "
            f"({data.file_meta.TransferSyntaxUID.name})"
        )
        continue
    same += 1

for problem, names in sorted(refused.items()):
    print(f"refused, {len(names)}: {problem}: {', '.join(names[:4])}")
print(f"{len(files)} files: {same} equal, {sum(map(len, refused.values()))} refused, {unread} pydicom cannot read, {len(faults)} faults")
for fault in faults:
    print(fault)
sys.exit(bool(faults))
