"""The code of the guide's page runs as it stands."""

from pathlib import Path

import pytest

import varda_da as varda

PAGE = Path(__file__).parents[3] / "docs" / "guide" / "python.md"


def blocks():
    text = PAGE.read_text(encoding="utf-8")
    return [part.split("```", 1)[0] for part in text.split("```python\n")[1:]]


@pytest.mark.skipif(not PAGE.exists(), reason="the guide is not beside the package")
def test_the_guide_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my-rod.toml").write_text(varda.show("hanging-rod"))
    names = {}
    for block in blocks():
        exec(compile(block, str(PAGE), "exec"), names)
    assert (tmp_path / "out" / "my-rod" / "report.html").exists()
    assert names["analysis"].chi2 < 4.0 and len(names["angles"]) == 100
