"""Writes the DICOM files of this folder with pydicom 3.0.2, highdicom 0.28.2 and gdcmconv of python-gdcm 3.2.6.

    make.py FOLDER

The scan has 10 x 8 x 4 samples. Sample (i, j, k) is stored as 7 i + 31 j + 101 k - 300, and slice k has the slope k + 1 and
the intercept -10 k, so that `tests/dicom.rs` knows every value. It is turned about all axes; positions are those of `place`.
"""

import os
import subprocess
import sys

import highdicom
import numpy as np
import pydicom
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.sequence import Sequence
from pydicom.sr.codedict import codes
from pydicom.uid import (
    CTImageStorage,
    DeflatedExplicitVRLittleEndian,
    EnhancedCTImageStorage,
    ExplicitVRBigEndian,
    ExplicitVRLittleEndian,
    ImplicitVRLittleEndian,
    RLELossless,
)

folder = sys.argv[1]
SHAPE = (4, 8, 10)
ROW = np.array([0.6, 0.8, 0.0])
COLUMN = np.array([-0.48, 0.36, 0.8])
NORMAL = np.cross(ROW, COLUMN)
# Distance between samples of a row, rows and slices.
STEP = (0.5, 0.75, 2.0)
ORIGIN = np.array([-100.0, 20.0, 300.0])
PREFIX = "1.2.826.0.1.3680043.8.498.1"
PADDING = -2000

k, j, i = np.indices(SHAPE)
stored = (7 * i + 31 * j + 101 * k - 300).astype(np.int16)


def place(k, tilt=0.0):
    return ORIGIN + k * STEP[2] * (NORMAL + tilt * COLUMN)


def decimals(numbers):
    return [f"{x:.10g}" for x in numbers]


def common(storage, syntax, series, instance):
    file = Dataset()
    file.file_meta = FileMetaDataset()
    file.file_meta.TransferSyntaxUID = syntax
    file.file_meta.MediaStorageSOPClassUID = file.SOPClassUID = storage
    file.file_meta.MediaStorageSOPInstanceUID = file.SOPInstanceUID = f"{PREFIX}.{series}.{instance}"
    file.file_meta.ImplementationClassUID = PREFIX
    file.StudyInstanceUID = f"{PREFIX}.0"
    file.SeriesInstanceUID = f"{PREFIX}.{series}"
    file.FrameOfReferenceUID = f"{PREFIX}.9"
    file.PatientName = "Secret^Name"
    file.PatientID = "secret-id"
    file.PatientBirthDate = file.PatientSex = file.AccessionNumber = file.StudyID = ""
    file.StudyDate, file.StudyTime = "20260101", "120000"
    file.Modality = "CT"
    file.SeriesNumber, file.InstanceNumber = str(series), str(instance)
    file.SeriesDescription = f"made {series}"
    file.SamplesPerPixel, file.PhotometricInterpretation = 1, "MONOCHROME2"
    file.Rows, file.Columns = SHAPE[1:]
    file.BitsAllocated, file.BitsStored, file.HighBit, file.PixelRepresentation = 16, 16, 15, 1
    return file


def slice_file(k, series=1, instance=None, tilt=0.0, syntax=ImplicitVRLittleEndian):
    file = common(CTImageStorage, syntax, series, k + 1 if instance is None else instance)
    file.ImageType = ["ORIGINAL", "PRIMARY", "AXIAL"]
    file.ImagePositionPatient = decimals(place(k, tilt))
    file.ImageOrientationPatient = decimals([*ROW, *COLUMN])
    file.PixelSpacing = decimals([STEP[1], STEP[0]])
    file.SliceThickness = decimals([STEP[2]])[0]
    file.RescaleSlope, file.RescaleIntercept = str(k + 1), str(-10 * k)
    file.PixelData = stored[k].tobytes()
    return file


def frames_file(syntax, series):
    file = common(EnhancedCTImageStorage, syntax, series, 1)
    file.ImageType = ["ORIGINAL", "PRIMARY", "VOLUME", "NONE"]
    file.NumberOfFrames = str(SHAPE[0])
    shared, measures, orientation = Dataset(), Dataset(), Dataset()
    measures.PixelSpacing = decimals([STEP[1], STEP[0]])
    measures.SliceThickness = decimals([STEP[2]])[0]
    orientation.ImageOrientationPatient = decimals([*ROW, *COLUMN])
    shared.PixelMeasuresSequence = Sequence([measures])
    shared.PlaneOrientationSequence = Sequence([orientation])
    file.SharedFunctionalGroupsSequence = Sequence([shared])
    frames = []
    # Frames are not in the order of their positions.
    order = [2, 0, 3, 1]
    for k in order:
        frame, position, values = Dataset(), Dataset(), Dataset()
        position.ImagePositionPatient = decimals(place(k))
        values.RescaleSlope, values.RescaleIntercept, values.RescaleType = str(k + 1), str(-10 * k), "HU"
        frame.PlanePositionSequence = Sequence([position])
        frame.PixelValueTransformationSequence = Sequence([values])
        frames.append(frame)
    file.PerFrameFunctionalGroupsSequence = Sequence(frames)
    samples = stored[order]
    file.PixelData = samples.astype(">i2" if syntax == ExplicitVRBigEndian else "<i2").tobytes()
    return file


def save(file, name):
    path = os.path.join(folder, name)
    os.makedirs(os.path.dirname(path), exist_ok=True)
    syntax = file.file_meta.TransferSyntaxUID
    pydicom.dcmwrite(path, file, enforce_file_format=True, implicit_vr=syntax.is_implicit_VR, little_endian=syntax.is_little_endian)
    return path


# A series whose names are not in the order of its slices, with a localizer.
for k, name in enumerate("cadb"):
    save(slice_file(k), f"series/{name}")
localizer = slice_file(0, instance=99)
localizer.ImageType = ["ORIGINAL", "PRIMARY", "LOCALIZER"]
localizer.ImageOrientationPatient = decimals([*ROW, *NORMAL])
save(localizer, "series/localizer")

# Samples of padding, as a writer stores them that takes the value for an unsigned one.
padded = slice_file(0, series=2, syntax=ExplicitVRLittleEndian)
samples = stored[0].copy()
samples[2, 3] = PADDING
padded.PixelData = samples.tobytes()
padded.PixelPaddingValue = PADDING
save(padded, "padded.dcm")

for k in range(SHAPE[0]):
    save(slice_file(k, series=3, tilt=0.25, syntax=ExplicitVRLittleEndian), f"tilted/{k}.dcm")

save(frames_file(ExplicitVRLittleEndian, 4), "frames.dcm")
save(frames_file(ExplicitVRBigEndian, 5), "big_endian.dcm")
save(frames_file(DeflatedExplicitVRLittleEndian, 6), "deflated.dcm")
rle = frames_file(ExplicitVRLittleEndian, 7)
rle.compress(RLELossless, generate_instance_uid=False)
save(rle, "rle.dcm")
convert = os.path.join(os.path.dirname(sys.executable), "gdcmconv")
for series, name, option in [(8, "jpeg_2000.dcm", "--j2k"), (9, "jpeg_lossless.dcm", "--jpeg"), (10, "jpeg_ls.dcm", "--jpegls")]:
    plain = save(frames_file(ExplicitVRLittleEndian, series), name)
    subprocess.run([convert, option, plain, plain + ".out"], check=True)
    os.replace(plain + ".out", plain)

# Segmentations of the series: slices 0 and 3 have no segment in the first, slice 2 none in the last.
sources = [slice_file(k, syntax=ExplicitVRLittleEndian) for k in range(SHAPE[0])]


def description(number, label):
    return highdicom.seg.SegmentDescription(
        segment_number=number,
        segment_label=label,
        segmented_property_category=codes.SCT.Tissue,
        segmented_property_type=codes.SCT.Bone,
        algorithm_type="MANUAL",
    )


def segmentation(pixels, kind, labels, series, name):
    file = highdicom.seg.Segmentation(
        source_images=sources,
        pixel_array=pixels,
        segmentation_type=kind,
        segment_descriptions=[description(number, label) for number, label in labels],
        series_instance_uid=f"{PREFIX}.{series}",
        series_number=series,
        sop_instance_uid=f"{PREFIX}.{series}.1",
        instance_number=1,
        manufacturer="made",
        manufacturer_model_name="made",
        software_versions="1",
        device_serial_number="1",
    )
    file.save_as(os.path.join(folder, name))


labels = np.zeros(SHAPE, np.uint8)
labels[1, 2:5, 3:7] = 1
labels[2, 4:7, 1:9] = 2
segmentation(labels, "BINARY", [(1, "bone"), (2, "Left lung")], 11, "seg_binary.dcm")
overlapping = np.zeros((*SHAPE, 2), bool)
overlapping[0, 1:4, 2:6, 0] = overlapping[3, 1:4, 2:6, 0] = True
overlapping[1, 0:3, 4:9, 1] = overlapping[3, 3:6, 5:8, 1] = True
segmentation(overlapping, "BINARY", [(1, "bone"), (2, "tumour")], 12, "seg_overlapping.dcm")
numbers = np.zeros(SHAPE, np.uint16)
numbers[1:3, 2:5, 3:7] = 3
numbers[2, 5:7, 1:9] = 300
segmentation(numbers, "LABELMAP", [(3, "bone"), (300, "Left lung")], 13, "seg_labels.dcm")
