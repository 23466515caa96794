"""Runs every notebook in examples/ from its first cell to its last, in a folder of its own; with the argument
`--scripts FOLDER` it only writes their code there, for a type checker, with `--keep FOLDER` what they show."""

import sys
import tempfile
import time
from pathlib import Path

import nbformat
from nbclient import NotebookClient

what, folder_of_results = (sys.argv[1:] + [""] * 2)[:2]
for path in sorted((Path(__file__).parent / "examples").glob("*.ipynb")):
    if what == "--scripts":
        cells = [cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code"]
        Path(folder_of_results, path.with_suffix(".py").name).write_text("\n\n".join(cells) + "\n")
        continue
    begun = time.monotonic()
    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(
            notebook,
            timeout=300,
            resources={"metadata": {"path": folder}},
            extra_arguments=["--IPKernelApp.log_level=ERROR"],
        )
        client.execute()
    if what == "--keep":
        nbformat.write(notebook, Path(folder_of_results) / path.name)
    print(f"{path.name}: {time.monotonic() - begun:.0f} s")
