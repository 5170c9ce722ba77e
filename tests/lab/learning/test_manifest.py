from __future__ import annotations

import hashlib
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from safety_harness.base.exceptions import DatasetError, OutputError
from safety_harness.base.settings import DEFAULTS, ObjectKind
from safety_harness.extensions.lab.learning.dataset import CompactDataset, generate, seen, space_named
from safety_harness.extensions.lab.learning.manifest import (
    ARRAYS,
    MANIFEST,
    data_hash,
    load_dataset,
    manifest_of,
    save_dataset,
)

SETTINGS = replace(
    DEFAULTS,
    servo=replace(DEFAULTS.servo, object_kind=ObjectKind.DISCRETE),
    avoidance=replace(DEFAULTS.avoidance, hand_pull=0.1 / 3.0),
)
DATASET = generate(SETTINGS, space_named("unseen both", SETTINGS), seed=2, tcps=40, candidates=20, hands=6)
NAMES = ("tcp_in_base", "selected_in_base", "optimum_in_base", "candidates_in_view", "hand_in_base")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    save_dataset(DATASET, tmp_path / "data")
    return tmp_path / "data"


def rewrite(folder: Path, *, honest: bool = True, **changes: object) -> None:
    """Change the manifest; ``honest``: with a hash that fits, as another version would have."""
    manifest = json.loads((folder / MANIFEST).read_text()) | changes
    if honest:
        rest = {name: value for name, value in manifest.items() if name != "sha256"}
        manifest["sha256"] = hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()
    (folder / MANIFEST).write_text(json.dumps(manifest))


def store(folder: Path, **changes: np.ndarray) -> None:
    """Other arrays under the old manifest."""
    arrays = {name: getattr(DATASET, name) for name in NAMES} | changes
    with (folder / ARRAYS).open("wb") as file:
        np.savez(file, **arrays)


def test_a_data_set_comes_back_as_it_was_saved(folder: Path) -> None:
    loaded = load_dataset(folder)
    assert loaded.settings == DATASET.settings
    assert loaded.space == DATASET.space
    assert loaded.seed == DATASET.seed
    for name in NAMES:
        assert np.array_equal(getattr(loaded, name), getattr(DATASET, name))
        assert getattr(loaded, name).dtype == getattr(DATASET, name).dtype
    index = np.arange(len(DATASET))
    assert np.array_equal(loaded.targets(index), DATASET.targets(index))
    assert manifest_of(loaded) == manifest_of(DATASET)
    assert sorted(path.name for path in folder.iterdir()) == [ARRAYS, MANIFEST]


def test_what_a_manifest_says_is_enough_to_make_the_data_set_again(folder: Path) -> None:
    stored = load_dataset(folder)
    again = generate(
        stored.settings,
        stored.space,
        seed=stored.seed,
        tcps=stored.tcps,
        candidates=stored.candidates,
        hands=stored.hands,
    )
    assert data_hash(again) == data_hash(DATASET)
    manifest = json.loads((folder / MANIFEST).read_text())
    assert manifest["samples"] == 240
    assert manifest["views_without_object"] == DATASET.views_without_object
    assert manifest["package_version"]


def test_the_hash_of_an_array_is_that_of_its_bytes(folder: Path) -> None:
    manifest = json.loads((folder / MANIFEST).read_text())
    for name in NAMES:
        expected = hashlib.sha256(getattr(DATASET, name).tobytes()).hexdigest()
        assert manifest["arrays"][name]["sha256"] == expected


def test_the_data_hash_tells_data_apart_and_not_versions() -> None:
    other_gain = replace(DATASET, settings=replace(SETTINGS, servo=replace(SETTINGS.servo, gain_far=0.5)))
    assert data_hash(other_gain) == data_hash(DATASET)
    assert data_hash(DATASET.without_noise()) != data_hash(DATASET)


def test_saving_replaces_what_was_there(folder: Path) -> None:
    other = generate(DEFAULTS, seen(DEFAULTS), seed=9, tcps=5, candidates=3, hands=2)
    save_dataset(other, folder)
    assert data_hash(load_dataset(folder)) == data_hash(other)


def test_a_place_that_cannot_be_written_is_an_output_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="can be written"):
        save_dataset(DATASET, tmp_path / "file")


@pytest.mark.parametrize("name", [ARRAYS, MANIFEST])
def test_a_missing_file_is_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    with pytest.raises(DatasetError, match=rf"{name}.*no such file"):
        load_dataset(folder)


@pytest.mark.parametrize("name", [ARRAYS, MANIFEST])
@pytest.mark.parametrize("share", [0.0, 0.3, 0.95])
def test_a_truncated_file_is_refused(folder: Path, name: str, share: float) -> None:
    data = (folder / name).read_bytes()
    (folder / name).write_bytes(data[: int(share * len(data))])
    with pytest.raises(DatasetError, match=name):
        load_dataset(folder)


def test_any_flipped_byte_of_the_arrays_is_noticed_or_harmless(folder: Path) -> None:
    """A byte of the archive's own bookkeeping may change; a number never does unnoticed."""
    data = (folder / ARRAYS).read_bytes()
    refused = 0
    for place in np.random.default_rng(1).integers(0, len(data), 60):
        damaged = bytearray(data)
        damaged[place] ^= 0x10
        (folder / ARRAYS).write_bytes(damaged)
        try:
            assert data_hash(load_dataset(folder)) == data_hash(DATASET)
        except DatasetError:
            refused += 1
    assert refused > 40


def test_a_changed_number_is_refused_by_its_hash(folder: Path) -> None:
    changed = DATASET.selected_in_base.copy()
    changed[3, 1] = np.nextafter(changed[3, 1], 1.0)
    store(folder, selected_in_base=changed)
    with pytest.raises(DatasetError, match=r"selected_in_base.*sha256"):
        load_dataset(folder)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("hand_in_base", np.zeros((6, 2))),
        ("hand_in_base", np.zeros((6, 3), np.float32)),
        ("selected_in_base", np.zeros((39, 3))),
        ("candidates_in_view", np.zeros((40, 3), np.int64)),
        ("tcp_in_base", np.zeros((0, 3))),
        ("tcp_in_base", np.float64(3.0)),
    ],
)
def test_another_shape_or_type_is_refused(folder: Path, name: str, array: np.ndarray) -> None:
    store(folder, **{name: array})
    with pytest.raises(DatasetError, match="shape"):
        load_dataset(folder)


def test_a_missing_array_is_named(folder: Path) -> None:
    with (folder / ARRAYS).open("wb") as file:
        np.savez(file, tcp_in_base=DATASET.tcp_in_base)
    with pytest.raises(DatasetError, match="selected_in_base"):
        load_dataset(folder)


def test_a_pickle_is_never_opened(folder: Path) -> None:
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return Path.touch, (folder / "sprung",)

    buffer = io.BytesIO()
    np.save(buffer, np.array([Trap()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(folder / ARRAYS, "w") as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", buffer.getvalue())
    with pytest.raises(DatasetError, match="allow_pickle"):
        load_dataset(folder)
    assert not (folder / "sprung").exists()


def test_a_manifest_that_was_edited_is_refused(folder: Path) -> None:
    rewrite(folder, honest=False, seed=3)
    with pytest.raises(DatasetError, match="changed since"):
        load_dataset(folder)


def test_another_format_is_refused(folder: Path) -> None:
    rewrite(folder, format="safety-harness dataset 2")
    with pytest.raises(DatasetError, match="'safety-harness dataset 1'"):
        load_dataset(folder)
    (folder / MANIFEST).write_text("[]")
    with pytest.raises(DatasetError, match="got list"):
        load_dataset(folder)


def test_settings_of_another_version_are_refused_by_name(folder: Path) -> None:
    settings = json.loads((folder / MANIFEST).read_text())["settings"]
    settings["avoidance"]["eagerness"] = 1.0
    rewrite(folder, settings=settings)
    with pytest.raises(DatasetError, match="eagerness"):
        load_dataset(folder)
    del settings["avoidance"]["eagerness"], settings["avoidance"]["hand_pull"]
    rewrite(folder, settings=settings)
    with pytest.raises(DatasetError, match="hand_pull"):
        load_dataset(folder)


@pytest.mark.parametrize(
    "changes", [{"tcps": 41}, {"space": None}, {"seed": "?"}, {"arrays": {}}, {"settings": []}]
)
def test_a_manifest_that_does_not_fit_is_refused(folder: Path, changes: dict[str, object]) -> None:
    rewrite(folder, **changes)
    with pytest.raises(DatasetError, match=MANIFEST):
        load_dataset(folder)


def test_a_data_set_of_the_papers_size_is_small(tmp_path: Path) -> None:
    few_images = generate(DEFAULTS, seen(DEFAULTS), seed=1, tcps=10_000, candidates=1, hands=500)
    save_dataset(few_images, tmp_path)
    assert len(load_dataset(tmp_path)) == 5_000_000
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) < 1_000_000


def test_loading_makes_a_compact_dataset(folder: Path) -> None:
    assert isinstance(load_dataset(folder), CompactDataset)
