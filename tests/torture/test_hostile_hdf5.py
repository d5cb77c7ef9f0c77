"""HDF5 files made by hand to hurt: refused by name, or read, at once and in little memory."""

from tests.torture.support.children import fared, least_cpu_s
from tests.torture.support.hostile import hostile_maps, truncated_maps
from tests.torture.support.sizes import chance, size

_READING = "tests.torture.support.reading"
_STEP = size("truncation_step", 61)  # bytes between the lengths at which a map is cut off
_HOSTILE = size("hostile", 300)
_LONGEST_CPU_S = 1.0
_GROWN_BYTES = 200 * 2**20


def chosen_maps() -> dict[str, bytes]:
    made = hostile_maps()
    patched = [name for name in made if " at " in name]
    left_out = chance("hostile").sample(patched, max(0, len(patched) - _HOSTILE))
    return {name: content for name, content in made.items() if name not in set(left_out)}


def faults_of(files: list[bytes], names: list[str], folder) -> list[str]:
    given = folder / "given"
    given.mkdir()
    for number, content in enumerate(files):
        (given / str(number)).write_bytes(content)
    wrong: list[str] = []
    least = 0
    words = ["PaperMap", str(folder)]
    for one in fared(_READING, words, 0, len(files)):
        least = least or one.memory_bytes
        bad = one.how.startswith(("hung", "died", "ended", "unnamed"))
        cpu_s = least_cpu_s(_READING, words, one, _LONGEST_CPU_S)
        if bad or cpu_s > _LONGEST_CPU_S:
            wrong.append(f"{names[one.number]}: {one.how} in {cpu_s:.2f} s")
        if one.memory_bytes - least > _GROWN_BYTES:
            wrong.append(f"{names[one.number]}: {one.memory_bytes / 2**20:.0f} MB are held")
            least = one.memory_bytes
    return wrong


def test_hostile_maps_are_refused_by_name(tmp_path):
    made = chosen_maps()
    wrong = faults_of(list(made.values()), list(made), tmp_path)
    assert not wrong, f"{len(wrong)} of {len(made)}:\n" + "\n".join(wrong[:20])


def test_a_map_cut_off_anywhere_is_refused_by_name(tmp_path):
    files = list(truncated_maps(_STEP))
    names = [f"the first {len(content)} bytes" for content in files]
    wrong = faults_of(files, names, tmp_path)
    assert not wrong, f"{len(wrong)} of {len(files)}:\n" + "\n".join(wrong[:20])
