"""Runs every notebook in examples/ from its first cell to its last, each in a folder of its own.

With the argument `--scripts FOLDER`, it only writes the code of the notebooks there, for a type checker. With
`--keep FOLDER`, it writes the notebooks with their output there.
"""

import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

mode, output_folder = (sys.argv[1:] + [""] * 2)[:2]
for path in sorted((Path(__file__).parent / "examples").glob("*.ipynb")):
    if mode == "--scripts":
        cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        Path(output_folder, path.with_suffix(".py").name).write_text("\n\n".join(cells) + "\n")
        continue
    start = time.monotonic()
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=300,
            resources={"metadata": {"path": folder}},
            extra_arguments=["--IPKernelApp.log_level=ERROR"],
        )
        client.execute()
    if mode == "--keep":
        nbformat.write(notebook, Path(output_folder) / path.name)
    print(f"{path.name}: {time.monotonic() - start:.0f} s")
