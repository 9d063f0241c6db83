"""What the pages show works: every code block is run, page by page, in an empty folder; those that take long in `make
soak` alone."""

import itertools
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from nlos.configs.describe import describe
from nlos.schemas import blocks, model_of

DOCS = Path(__file__).parents[2] / "docs"
SHOWN = {path.relative_to(DOCS.parent).as_posix(): path.read_text(encoding="utf-8")
         for path in (*DOCS.glob("*.md"), *DOCS.glob("howto/*.md"), DOCS.parent / "README.md")}  # fmt: skip
PAGES = sorted(name for name, text in SHOWN.items() if re.search(r"^```(sh|python)\n", text, re.M))
PAGES.remove("docs/tutorial.md")  # a test of its own: it is run at the top of a clone
SOAK = bool(os.environ.get("NLOS_SOAK"))
LONG = tuple(
    f"docs/howto/{name}.md"
    for name in ("archives", "judging", "methods", "moving-scenes", "my-data", "runs", "training")
)
"""A third of a minute to a whole one each; in `make soak`. What they say is tested elsewhere, too."""
BLOCK = re.compile(r"^(<!-- not run: [^\n]* -->\n)?```(sh|python)\n(.*?)^```", re.S | re.M)


@pytest.mark.soak
@pytest.mark.parametrize("page", PAGES if SOAK else [page for page in PAGES if page not in LONG])
def test_every_block_of_a_page_runs(page: str, tmp_path: Path) -> None:
    run_page(page, tmp_path, long=False)


@pytest.mark.soak
@pytest.mark.skipif(not SOAK, reason="the blocks that take a minute: make soak")
@pytest.mark.parametrize("page", [page for page in PAGES if "make soak runs" in SHOWN[page]])
def test_every_long_block_of_a_page_runs(page: str, tmp_path: Path) -> None:
    run_page(page, tmp_path, long=True)


@pytest.mark.parametrize("page", SHOWN)
def test_no_command_stands_where_nothing_runs_it(page: str) -> None:
    """Neither in a block without a language nor in an indented one."""
    text = re.sub(r"^ *```[a-z]+\n.*?^ *```", "", SHOWN[page], flags=re.S | re.M)
    plain = "\n".join(re.findall(r"^```\n(.*?)^```", text, re.S | re.M) + re.findall(r"^    .*", text, re.M))
    assert not re.findall(r"^ *(?:nlos [a-z]+ |python -|import |from [a-z.]+ import |with ).*", plain, re.M)


def test_every_command_of_the_first_day_names_its_bench() -> None:
    """Without `--bench` it would drive the simulated bench that ships, whatever stands on the table."""
    page = SHOWN["docs/howto/first-day.md"]
    code = "".join(block for _, _, block in BLOCK.findall(page))
    drives = re.findall(r"^nlos (?!new |reconstruct |figure )[^#\n]*", code, re.M)  # these drive nothing
    assert len(drives) >= 9
    assert [each for each in drives if "--bench" not in each and "first.h5 --spots" not in each] == []
    assert "--reconstruct" in code


def run_page(page: str, tmp_path: Path, long: bool) -> None:
    text = SHOWN[page]
    shown = text.count("\n```sh\n") + text.count("\n```python\n")
    found = BLOCK.findall(text)
    assert len(found) == shown, "a block that this test does not see"
    array = "import numpy as np\nhistograms = np.random.default_rng(0).poisson(0.5, (16, 16, 128))\n"
    (tmp_path / "blocks.py").write_text(array if page == "README.md" else "")  # the README's is the reader's own
    script = ["set -euo pipefail"]
    kept = [(language, code) for skipped, language, code in found if not skipped or (long and "make soak" in skipped)]
    for (language, code), (following, _) in itertools.zip_longest(kept, kept[1:], fillvalue=("", "")):
        if language == "sh":
            script.append(code)
            continue
        script += ["cat >> blocks.py <<'END_OF_BLOCK'", code.rstrip(), "END_OF_BLOCK"]
        if following != "python":  # blocks of Python share their names: each run repeats the earlier ones
            script += ["rm -rf out run.h5*", "python blocks.py"]
    here = os.environ | {"PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    words = ["bash", "-c", "\n".join(script)]
    done = subprocess.run(
        words, cwd=tmp_path, env=here, capture_output=True, text=True, timeout=900 if long else 280, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_settings_pages_are_made_from_the_classes() -> None:
    sys.path.insert(0, str(DOCS))
    try:
        from make_settings import pages  # type: ignore[import-not-found]
    finally:
        sys.path.pop(0)
    for name, text in pages().items():
        assert (DOCS / "settings" / name).read_text(encoding="utf-8") == text, "run: python docs/make_settings.py"


@pytest.mark.parametrize("kind", ["scan", "train", "bench", "queue", "defaults"])
def test_every_key_says_what_it_means(kind: str) -> None:
    for block in blocks(model_of(kind)):
        for key, setting in describe(block).items():
            assert setting.what or key in ("kind", "model"), f"{block.__name__}: {key} has no meaning"


def test_every_extra_of_the_package_is_in_the_table() -> None:
    project = tomllib.loads((DOCS.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    rows = [line for line in (DOCS / "index.md").read_text(encoding="utf-8").splitlines() if line.startswith("| `")]
    named = {name for row in rows for name in re.findall(r"`(\w+)`", row.split("|")[1])}
    assert named == set(project["optional-dependencies"])


def test_every_column_of_an_evaluation_is_explained() -> None:
    from dataclasses import fields

    from nlos.recon.evaluate import Row

    page = (DOCS / "howto" / "judging.md").read_text(encoding="utf-8")
    figures = page[page.index("## What the figures mean") :]
    assert [field.name for field in fields(Row) if f"`{field.name}`" not in figures] == []
    assert "`NAME~300ps`" in page


def test_every_exit_code_is_on_its_page() -> None:
    from nlos.cli.exit_codes import ExitCode

    rows = re.findall(r"^\| (\d+) \|", SHOWN["docs/exit-codes.md"], re.M)
    assert [int(code) for code in rows] == sorted(ExitCode)
    assert "(../exit-codes.md)" in SHOWN["docs/howto/archives.md"]


def test_every_page_is_in_the_menu() -> None:
    menu = (DOCS.parent / "mkdocs.yml").read_text(encoding="utf-8").split("\nnav:\n")[1]
    pages = [*DOCS.glob("*.md"), *DOCS.glob("howto/*.md"), *DOCS.glob("settings/*.md")]
    assert [page for each in pages if f": {(page := each.relative_to(DOCS).as_posix())}\n" not in menu] == []


def test_both_pages_with_the_same_figure_name_the_same_depths() -> None:
    captions = [re.search(r"bear 0[^!]*?staircase [^!]*?\d\.\d\d\b[^!]*?\d\.\d\d", SHOWN[f"docs/{name}.md"], re.S)
                for name in ("gallery", "results")]  # fmt: skip
    depths = [re.findall(r"\d\.\d\d", caption[0]) for caption in captions if caption]
    assert len(depths[0]) == 14
    assert depths[0] == depths[1]
