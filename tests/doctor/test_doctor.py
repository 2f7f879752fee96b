"""What `lobewise doctor` says of a machine, and of one that lacks something."""

import json
import os
import re
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lobewise.cli.doctor import folders, machine, packages
from lobewise.cli.doctor.report import Problem, Report, Section, name_path
from lobewise.cli.program import run
from lobewise.errors import MissingDependencyError
from lobewise.peers import OidnFault, has_oidn

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

PAGE = (Path(__file__).parents[2] / "docs" / "command_line.md").read_text()


def say(report: Report) -> str:
    return "\n".join(report.list_lines())


class TestVerb:
    def test_the_report_names_what_users_are_asked_for(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["doctor"]) == 0
        out = capsys.readouterr().out
        assert re.match(r"lobewise \S+: works here\n", out)
        for word in ("numpy", "openexr", "halide", "llvmlite", "pyoidn", "mitsuba", "viser", "distributed", "usd-core"):
            assert re.search(rf"\b{word} +(\d|not installed)", out), word
        for word in ("cpu", "vulkan", "cuda", "encoding", "memory", "LOBEWISE_CACHE", "temporary"):
            assert re.search(rf"^  {word} +\S", out, flags=re.M), word
        assert re.search(r"test +filtered an image of 16x16 pixels in \d", out)
        assert re.search(r"^Problems\n", out, flags=re.M)
        assert "\x1b" not in out

    def test_json_holds_the_same(self, capsys: pytest.CaptureFixture[str]) -> None:
        assert run(["doctor", "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["works"] is True
        assert found["sections"]["Devices"]["cpu"].startswith("yes")
        sections = re.findall(r"^\| (`.*`) \|", PAGE, flags=re.M)
        named = {name for row in sections for name in re.findall(r"`([A-Za-z ]+)`", row)}
        assert {*found["sections"], "Problems"} <= named

    @pytest.mark.parametrize(
        ("module", "told"),
        [
            ("OpenEXR", r"openexr cannot be loaded \(ModuleNotFoundError.*pip install --force-reinstall"),
            pytest.param("numpy", r"numpy cannot be loaded", marks=pytest.mark.nightly),
            ("halide", r"halide cannot be loaded"),
        ],
    )
    def test_a_package_that_does_not_load(self, module: str, told: str) -> None:
        code = f"import sys; sys.modules[{module!r}] = None; from lobewise.cli import main; main(['doctor'])"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
        assert done.stderr == ""
        works = module == "halide" and (has_oidn() or not re.search(r"in the package +none", done.stdout))
        assert done.returncode == (0 if works else 2)
        assert re.search(told, done.stdout)


class TestReport:
    def test_fatal_problems_come_first(self) -> None:
        small, large = Problem("a disk is full", "free some space"), Problem("numpy is gone", "install it", fatal=True)
        report = Report("1.2", (Section("One", {"a": "b"}, (small,)), Section("Two", {}, (large,))))
        assert not report.works
        assert say(report).splitlines()[0] == "lobewise 1.2: cannot work here"
        assert say(report).splitlines()[-2:] == ["  numpy is gone: install it.", "  a disk is full: free some space."]
        assert report.to_record()["problems"][0] == {"what": "numpy is gone", "action": "install it", "fatal": True}
        assert Report("1.2", report.sections[:1]).works

    def test_control_characters_are_printed_as_text(self) -> None:
        assert "\x1b" not in say(Report("1", (Section("One", {"TERM": "\x1b[31m"}),)))

    def test_the_home_folder_is_not_told(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(Path, "home", lambda: Path("/home/ann"))
        assert name_path("/home/ann/x/y") == "~/x/y"
        assert name_path("/home/anna/x") == "/home/anna/x"
        assert name_path("/home/ann") == "~"

        def fail() -> Path:
            raise RuntimeError

        monkeypatch.setattr(Path, "home", fail)
        assert name_path("/home/ann/x") == "/home/ann/x"


class TestPackages:
    LINES = (
        "numpy>=1.26",
        'tomli>=2.0; python_version < "3.11"',
        'Halide<22,>=21; extra == "jit"',
        "scipy>=1.11; extra == 'fit'",
        'usd-core>=24.11; (python_version < "3.14") and extra == "usd"',
        'pytest>=8; extra == "dev"',
        'lobewise[fit]; extra == "demo"',
        "llvmlite>=0.44; python_version < '3.14' and (sys_platform != 'linux' or platform_machine == 'x86_64')",
    )

    def test_requirements_are_read(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(packages, "_look_up_version", lambda name: "1.30")
        monkeypatch.setattr(packages.sys, "platform", "linux")
        monkeypatch.setattr(packages.platform, "machine", lambda: "x86_64")
        found = list(packages.parse_requirements(list(self.LINES), (3, 12)))
        told = [(package.name, package.versions, package.extra) for package in found]
        assert told == [
            ("numpy", ">=1.26", ""),
            ("Halide", "<22,>=21", "jit"),
            ("scipy", ">=1.11", "fit"),
            ("usd-core", ">=24.11", "usd"),
            ("llvmlite", ">=0.44", ""),
        ]
        assert [package.fits for package in found] == [True, False, True, False, True]
        names = [package.name for package in packages.parse_requirements(list(self.LINES), (3, 10))]
        assert names[:2] == ["numpy", "tomli"]
        monkeypatch.setattr(packages.platform, "machine", lambda: "aarch64")
        assert "llvmlite" not in [package.name for package in packages.parse_requirements(list(self.LINES), (3, 12))]
        monkeypatch.setattr(packages.sys, "platform", "darwin")
        assert [package.name for package in packages.parse_requirements(list(self.LINES), (3, 14))] == [
            "numpy",
            "Halide",
            "scipy",
        ]

    @pytest.mark.parametrize(
        ("version", "limits", "fits"),
        [("21.0.0", ">=21,<22", True), ("22", "<22,>=21", False), ("3.10", ">=3.9", True), ("1.0", "", True),
         ("2.0rc1", "<2", False), ("1.26.4", ">=1.27", False)],
    )  # fmt: skip
    def test_versions_are_compared_as_numbers(self, version: str, limits: str, fits: bool) -> None:
        assert packages.is_version_among(version, limits) is fits

    @pytest.mark.parametrize(
        ("name", "faulty", "mended", "python"),
        [
            ("OpenEXR", ["3.3.12", "3.4.0", "3.4.13", "3.5.2"], "3.5.3", (3, 12)),
            ("pillow", ["11.3.0", "12.3.0"], "13.0.0", (3, 12)),
            ("distributed", ["2025.12.0"], "2026.1.0", (3, 12)),
            ("OpenEXR", ["3.5.1"], "3.5.2", (3, 10)),
            ("pillow", ["12.2.0"], "12.3.0", (3, 10)),
        ],
    )
    def test_versions_with_published_faults_are_told(
        self, name: str, faulty: list[str], mended: str, python: tuple[int, int], monkeypatch: pytest.MonkeyPatch
    ) -> None:
        project = tomllib.loads((Path(__file__).parents[2] / "pyproject.toml").read_text())["project"]
        farm = [f"{line}; extra == 'farm'" for line in project["optional-dependencies"]["farm"]]
        monkeypatch.setattr(packages, "requires", lambda package: [*project["dependencies"], *farm])
        monkeypatch.setattr(packages.sys, "version_info", python)
        monkeypatch.setattr(packages, "_list_broken", lambda *_, **__: [])
        monkeypatch.setattr(packages, "_list_oidn_problems", list)
        for version in [*faulty, mended]:
            monkeypatch.setattr(packages, "_look_up_version", lambda other, v=version: v if other == name else "9999")
            sections = packages.examine_packages(), packages.examine_extras()
            told = [problem.what for section in sections for problem in section.problems]
            assert len(told) == (version != mended), told
            assert all(f"{name} is of version {version}" in what and "published faults" in what for what in told)

    def test_missing_and_old_packages(self, monkeypatch: pytest.MonkeyPatch) -> None:
        given = [
            packages.Package("gone", ">=1", "", ""),
            packages.Package("old", ">=3", "", "2.9"),
            packages.Package("halide", ">=21", "", ""),
            packages.Package("extra", ">=3", "more", "2.9"),
            packages.Package("absent", ">=3", "rare", ""),
        ]
        monkeypatch.setattr(packages, "read_packages", lambda: given)
        needed, extras = packages.examine_packages(), packages.examine_extras()
        assert [(problem.what, problem.fatal) for problem in needed.problems] == [
            ("gone is not installed", True),
            (
                "old is of version 2.9, and lobewise needs >=3, as other versions do not work or have published faults",
                True,
            ),
        ]
        assert [problem.fatal for problem in extras.problems] == [False]
        assert extras.facts["rare"] == "absent not installed (pip install 'lobewise[rare]')"

    def test_a_copy_that_pip_does_not_know(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail(name: str) -> list[str]:
            raise PackageNotFoundError(name)

        monkeypatch.setattr(packages, "requires", fail)
        found = packages.examine_packages()
        assert "was not installed by pip" in found.problems[0].what
        assert not found.problems[0].fatal

    def test_a_broken_open_image_denoise(self, monkeypatch: pytest.MonkeyPatch) -> None:
        fault = OidnFault("Open Image Denoise is installed but cannot be loaded (no such file)", "reinstall pyoidn")
        monkeypatch.setattr("lobewise.peers.look_up_oidn_fault", lambda: fault)
        (found,) = packages.examine_extras().problems
        assert found.action == "reinstall pyoidn"


class TestMachine:
    def test_a_machine_without_llvm(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail() -> str:
            raise MissingDependencyError("libLLVM", expected="version 16", got="none", action="apt install libllvm19")

        monkeypatch.setattr(machine, "_look_up_version", lambda name: "3.9.1")
        monkeypatch.setattr(machine, "locate_llvm", fail)
        (found,) = machine.examine_mitsuba().problems
        assert found.action == "apt install libllvm19"
        assert "libLLVM" in found.what
        assert not found.fatal

    def test_a_machine_without_mitsuba(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(machine, "_look_up_version", lambda name: "not installed")
        found = machine.examine_mitsuba()
        assert "pip install 'lobewise[mitsuba]'" in found.facts["mitsuba"]
        assert not found.problems

    def test_a_filter_that_fails(self, monkeypatch: pytest.MonkeyPatch) -> None:
        def fail() -> None:
            raise OSError("illegal instruction")

        monkeypatch.setattr(machine, "_filter_image", fail)
        (found,) = machine.examine_kernels().problems
        assert found.fatal
        assert "illegal instruction" in found.what

    def test_output_without_a_terminal(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(sys, "stdout", None)
        assert machine.examine_terminal().facts["output"] == "a file or a pipe"


class TestFolders:
    def test_kernels_are_counted(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        folder = tmp_path / "cache"
        folder.mkdir(mode=0o700)
        (folder / "a.kernel").write_bytes(b"x" * 1_500_000)
        (folder / "b.kernel").write_bytes(b"x" * 500_000)
        (folder / "notes.txt").write_text("no kernel")
        monkeypatch.setenv("LOBEWISE_CACHE", str(folder))
        found = folders.examine_cache()
        assert found.facts["size"] == "2 kernels, 2.0 MB"
        assert found.facts["writable"] == "yes"
        assert sorted(path.name for path in folder.iterdir()) == ["a.kernel", "b.kernel", "notes.txt"]
        assert not found.problems

    def test_an_absent_folder_is_not_made(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path / "new" / "cache"))
        assert folders.examine_cache().facts["writable"] == "yes"
        assert not (tmp_path / "new").exists()

    def test_the_cache_is_off(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("LOBEWISE_CACHE", "off")
        found = folders.examine_cache()
        assert found.facts == {"LOBEWISE_CACHE": "off", "folder": "none"}
        assert not found.problems

    @pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
    def test_a_folder_of_everybody(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        tmp_path.chmod(0o777)
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        (found,) = folders.examine_cache().problems
        assert "LOBEWISE_CACHE" in found.action
        assert folders.examine_cache().facts["writable"] == "no"

    def test_a_user_without_a_home(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.delenv("LOBEWISE_CACHE", raising=False)
        monkeypatch.setattr(folders, "locate_cache_folder", lambda: None)
        (found,) = folders.examine_cache().problems
        assert "no home folder" in found.what

    def test_a_full_disk(self, monkeypatch: pytest.MonkeyPatch) -> None:
        full: Any = SimpleNamespace(free=3e6)
        monkeypatch.setattr(folders.shutil, "disk_usage", lambda path: full)
        assert "has only 3 MB left" in folders.examine_data().problems[0].what

    def test_missing_files_of_the_package(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(folders, "NEEDED", ("data/gone.npz",))
        found = folders.examine_data()
        assert found.problems[0].fatal
        assert found.facts["files"] == "missing: data/gone.npz"
