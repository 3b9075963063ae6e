"""The virtual bench writes files like those measured by a person."""

from pathlib import Path

from trimtab.analysis.identify.virtual_bench import draw_craft, run_bench, write_bench


def test_virtual_bench_writes_its_csv_files(tmp_path: Path) -> None:
    files = write_bench(tmp_path, run_bench(draw_craft(3), 3))
    assert {f.name for f in files} >= {"servo.csv", "thrust.csv", "coast.csv", "sweep.csv", "up.csv"}
    assert (tmp_path / "servo.csv").read_text().startswith("pulse [us],angle [deg],way,trial\n1000,")
