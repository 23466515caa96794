"""Prints the datasets in the root of an HDF5 file as JSON: datasets.py FILE."""

import json
import sys

import h5py

with h5py.File(sys.argv[1]) as file:
    print(json.dumps({name: data[()].tolist() for name, data in file.items()}))
