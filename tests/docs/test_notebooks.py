"""The notebooks run from top to bottom in a kernel of their own."""

import asyncio
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

BOOKS = sorted((Path(__file__).parents[2] / "docs" / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("book", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(book: Path, tmp_path: Path) -> None:
    assert book.stat().st_size < 300_000, "keep outputs small"
    notebook = nbformat.read(book, as_version=4)
    assert any(cell.get("outputs") for cell in notebook.cells), "keep the outputs of a run"
    client = NotebookClient(notebook, timeout=240, kernel_name="python3", resources={"metadata": {"path": tmp_path}})
    asyncio.run(client.async_execute())  # `execute` leaves its event loop open
