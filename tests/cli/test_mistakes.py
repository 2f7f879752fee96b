"""What artists do wrong at the command line: one sentence each, which blames no file for an option."""

import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from lobewise.io import write_frame, write_image
from tests.cli.lines import fail
from tests.streaming.frames import change_radiance, make_scene

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
TO = "-o x.exr"
"""An output that could be written, beside an input that is not there where an option is wrong."""
LONG = "x" * 300 + ".exr"
"""A longer name than file systems keep."""

MISTAKES = {
    # Verbs and names of options.
    "denois a.exr": ("verb", "'denois'"),
    "help": ("verb", "'help'"),
    "a.exr": ("verb", "'a.exr'"),
    "--radius 3 a.exr": ("--radius", "none of that name", "an option of lobewise"),
    "export": ("lobewise export", "none"),
    "export web": ("lobewise export", "'web'"),
    "export --plan fast --list": ("--plan", "none of that name"),
    "bench fast": ("lobewise bench",),
    f"denoise gone.exr {TO} --similarty sg": ("--similarty",),
    "export passes filter wgsl -o x --radius 3": (
        "--radius",
        "none of that name",
        "an option of lobewise export passes",
    ),
    "compare a.exr -r b.exr --metric psnr": ("--metric",),
    # Words that are missing, or too many.
    "denoise": ("lobewise denoise",),
    "denoise a.exr -o": ("-o",),
    f"denoise gone.exr {TO} --radius": ("--radius", "none"),
    "denoise a.exr --overwrite=yes": ("--overwrite", "'yes'"),
    "upsample a.exr": ("--output", "none", "FILE"),
    "compare a.exr b.exr": ("--reference", "none"),
    "inspect a.exr b.exr": ("lobewise inspect",),
    "devices cuda": ("lobewise devices",),
    "export passes filter -o x": ("lobewise export passes",),
    "fit -o x.lobes": ("material", "neither"),
    # Values of the filter's options.
    f"denoise gone.exr {TO} --radius wide": ("--radius", "'wide'"),
    f"denoise gone.exr {TO} --radius -1": ("--radius", "-1"),
    f"denoise gone.exr {TO} --radius=900": ("--radius", "900"),
    f"denoise gone.exr {TO} --beta strong": ("--beta", "'strong'"),
    f"denoise gone.exr {TO} --beta nan": ("--beta", "nan"),
    f"denoise gone.exr {TO} --lobes 9": ("--lobes", "9"),
    f"denoise gone.exr {TO} --quality balancd": ("--quality", "'balancd'"),
    f"denoise gone.exr {TO} --similarity gxx": ("--similarity", "'gxx'"),
    f"denoise gone.exr {TO} --form ful": ("--form", "'ful'"),
    f"denoise gone.exr {TO} --form atrous --quality high": ("--form", "'atrous'", "'full' with quality 'high'"),
    f"denoise gone.exr {TO} --device gpu": ("--device",),
    f"denoise gone.exr {TO} --device metal": ("--device", "metal"),
    f"denoise gone.exr {TO} --with-oidn --quality fast": ("--quality", "'fast'"),
    f"denoise gone.exr {TO} --with-oidn --form atrous": ("--form", "'atrous'", "'full' with quality 'balanced'"),
    f"denoise gone.exr {TO} --bands odd": ("--bands", "'odd'"),
    f"denoise gone.exr {TO} --bands 0": ("--bands", "0"),
    f"denoise gone.exr {TO} --bands -4": ("--bands", "'-4'"),
    f"denoise gone.exr {TO} --bands 9 --with-oidn": (
        "--bands",
        "9",
        "auto or off with --with-oidn, which takes whole frames",
    ),
    f"denoise gone.exr {TO} --bands 9 --quality best": (
        "--bands",
        "9",
        "auto or off with --quality best, which takes whole frames",
    ),
    f"denoise gone.exr {TO} --offline --quality best": ("--quality", "'best'"),
    f"denoise gone.exr {TO} --bands 9 --adaptive 5% --scene showroom": (
        "--bands",
        "9",
        "auto or off with --adaptive, which takes whole frames",
    ),
    f"denoise gone.exr {TO} --bands 64 --only": ("--bands", "64", "auto or off with --only, which takes whole frames"),
    f"denoise gone.exr {TO} --max-memory lots": ("--max-memory", "'lots'"),
    f"denoise gone.exr {TO} --max-memory 100MB": ("--max-memory", "'100MB'"),
    f"denoise gone.exr {TO} --max-seconds soon": ("--max-seconds", "'soon'"),
    f"upsample gone.exr {TO} --max-seconds 0": ("--max-seconds", "0"),
    f"denoise gone.exr {TO} --material gone.lobes": ("--material 'gone.lobes'",),
    f"upsample gone.exr {TO} --scale 99": ("--scale", "99"),
    f"upsample gone.exr {TO} --place 1": ("--place", "'1'"),
    f"upsample gone.exr {TO} --scale 2 --place 0,2": ("--place", "(0, 2)"),
    f"upsample gone.exr {TO} --radius 99": ("--radius", "99"),
    f"upsample gone.exr {TO} --memory 0.5": ("--memory", "none"),
    f"upsample gone.exr {TO} --temporal --bilinear": ("--bilinear",),
    f"denoise gone.exr {TO} --wrap --bands 16": ("--bands", "16"),
    # What the file holds.
    f"denoise gone.exr {TO} --preset cyclse": ("--preset", "'cyclse'"),
    f"denoise gone.exr {TO} --preset gone.toml": ("--preset 'gone.toml'",),
    f"denoise gone.exr {TO} --map normal": ("--map", "'normal'"),
    f"denoise gone.exr {TO} --map nomral=N": ("--map", "'nomral'"),
    "inspect gone.exr --map normal=N:cube": ("--map normal, conversion",),
    f"denoise cycles.exr {TO} --map normal=N.X,N.Y,N.Z": ("--map normal", "'N.X'"),
    f"denoise cycles.exr {TO} --map normal=Foo": ("--map normal", "'Foo'"),
    f"denoise cycles.exr {TO} --map normal=Normall": ("--map normal", "'Normall'"),
    f"denoise cycles.exr {TO} --map normal=ViewLayer.Normal.X": ("--map normal", "'ViewLayer.Normal.X'"),
    f"denoise cycles.exr {TO} --also AO": ("--also AO",),
    f"denoise a.exr {TO} --also AO": ("--also",),
    f"denoise gone.exr {TO} --camera broken.json": ("--camera 'broken.json'",),
    f"denoise gone.exr {TO} --camera notes.txt": ("--camera 'notes.txt'",),
    f"denoise a.exr {TO} --half a.exr": ("--half", "the same image"),
    f"denoise a.exr {TO} --half small.exr": ("--half", "5x4 pixels"),
    f"denoise a.exr {TO} --half gone.exr": ("--half 'gone.exr'",),
    "denoise full --half b.exr": ("--half", "2 inputs"),
    "denoise in.#.exr -o x.#.exr --half a.exr": ("--half", "'a.exr' for 'in.#.exr'"),
    # Inputs.
    f"denoise gone.exr {TO}": ("input 'gone.exr'",),
    "denoise smal.exr": ("input 'smal.exr'",),
    "denoise a.exr x.exr": ("input 'x.exr'",),
    "denoise '*.gone'": ("input '*.gone'",),
    "denoise ~/a.exr": ("input '~/a.exr'",),
    "denoise $SHOT/a.exr": ("input '$SHOT/a.exr'",),
    r"denoise 'C:\shots\a.exr'": ("input 'C:\\\\shots\\\\a.exr'",),
    "denoise '\"gone.exr\"'": ("input '\"gone.exr\"'",),
    "denoise hollow": ("input 'hollow'", "none"),
    "inspect hollow": ("input 'hollow'", "a directory"),
    f"render shot.blend {TO}": ("scene", "the Blender file 'shot.blend'"),
    f"denoise notes.exr {TO}": ("input 'notes.exr'", "a file that does not begin like one"),
    "denoise a.exr -o clean": ("--output", "'clean'"),
    f"denoise picture.png {TO}": ("input 'picture.png'",),
    "denoise picture.jpg": ("input 'picture.jpg'",),
    f"denoise empty.exr {TO}": ("input 'empty.exr'",),
    f"denoise cut.exr {TO}": ("input 'cut.exr'",),
    "denoise --png cut.exr": ("input 'cut.exr'",),
    "denoise cut.exr -o cut.exr --overwrite": ("input 'cut.exr'",),
    f"denoise a.exr --half cut.exr {TO}": ("--half 'cut.exr'",),
    f"denoise nan.exr {TO} --bands off": ("radiance",),
    f"denoise nan.exr {TO} --bands 9": ("radiance",),
    f"denoise gone.exr {TO} --bands 9": ("input 'gone.exr'",),
    "inspect cut.exr": ("input 'cut.exr'",),
    "denoise -": ("--output", "none", "a file, or -"),
    "denoise - a.exr -o full/": ("input",),
    f"upsample a.exr {TO}": ("input 'a.exr'",),
    f"upsample cycles.exr {TO}": ("input 'cycles.exr'",),
    "upsample in.#.exr -o x.#.exr": ("input 'in.1.exr'",),
    f"inspect {LONG}": (f"input '{LONG}'",),
    f"denoise {LONG} {TO}": (f"input '{LONG}'",),
    f"upsample {LONG} {TO}": (f"input '{LONG}'",),
    f"view {LONG}": (f"input '{LONG}'",),
    f"fit {LONG} -o x.lobes": (f"input '{LONG}'",),
    # Outputs.
    f"render showroom -o {LONG}": (f"--output '{LONG}'", "file name too long", "a path that can be written"),
    f"export filter -o {LONG}": (f"--output '{LONG}'", "file name too long", "a new or empty folder"),
    "upsample a.exr -o b.exr/": ("--output 'b.exr/'",),
    "inspect a.exr --html b.exr/": ("--html 'b.exr/'",),
    "compare a.exr -r a.exr --json b.exr/": ("--json 'b.exr/'",),
    "fit gone.binary -o b.exr/": ("--output 'b.exr/'",),
    "denoise gone.exr -o x.png": ("--output", "'x.png'"),
    "upsample gone.exr -o x.jpg": ("--output", "'x.jpg'"),
    "render showroom -o x.png": ("--output", "'x.png'"),
    "denoise gone.exr -o gone/x.exr": ("--output 'gone/x.exr'",),
    "upsample a.exr -o full": ("--output 'full'", "a directory"),
    "denoise gone.exr -o a.exr/x.exr": ("--output 'a.exr/x.exr'",),
    "denoise gone.exr -o locked.exr": ("--output 'locked.exr'",),
    "denoise a.exr -o a.exr": ("--output 'a.exr'", "the input"),
    "denoise full -o full": ("output 'full/a.exr'",),
    "denoise full -o x.exr": ("--output", "the file 'x.exr'"),
    "denoise full/a.exr more/a.exr -o x": ("inputs", "two for 'x/a.exr'"),
    "denoise a.exr a.exr": ("inputs", "two for 'a_clean.exr'"),
    "denoise a.exr -o clean.####.exr": ("--output", "'clean.####.exr', which stands for a sequence"),
    "upsample a.exr -o 'clean.$F4.exr'": ("--output", "'clean.$F4.exr', which stands for a sequence"),
    "demo -o a.exr": ("--output 'a.exr'", "file exists"),
    f"denoise gone.exr {TO} --exposure 1": ("--exposure", "none"),
    f"denoise gone.exr {TO} --png --exposure 99": ("--exposure", "99"),
    f"denoise gone.exr {TO} --png --exposure nan": ("--exposure", "nan"),
    f"denoise gone.exr {TO} --view AgX": ("--view", "none"),
    f"denoise gone.exr {TO} --png --view AgX": ("--ocio",),
    f"denoise gone.exr {TO} --png --ocio gone.ocio": ("--ocio 'gone.ocio'",),
    f"denoise gone.exr {TO} --png --ocio raw.ocio --display tv": ("--display",),
    f"upsample gone.exr {TO} --png --ocio raw.ocio --view Row": ("--view", "'Row'"),
    "denoise gone.exr -o - --png": ("--png", "'-'"),
    f"denoise gone.exr {TO} --tev": ("--tev",),
    # Sequences.
    f"denoise in.#{LONG} -o x.#.exr": (f"sequence 'in.#{LONG}'",),
    "denoise in.#.exr -o x.#.exr --temporal --bands 9": (
        "--bands",
        "9",
        "auto or off with --temporal, which takes whole frames",
    ),
    "denoise gone.#.exr -o x.#.exr": ("sequence 'gone.#.exr'",),
    "denoise gone.#.exr -o x.exr": ("--output", "'x.exr'"),
    "denoise in.#.exr -o x.#.exr --overwrite": (
        "--overwrite",
        "the sequence 'in.#.exr', which could not go on after a stop",
    ),
    f"denoise gone.exr {TO} --frames 1-3": ("--frames", "'gone.exr'"),
    "denoise gone.#.exr -o x.#.exr --frames 3-1": ("--frames", "'3-1'"),
    "denoise in.#.exr -o x.#.exr --frames 1-2 --png": ("--png", "none"),
    "denoise in.#.exr -o x.#.exr --frames 2-4": ("sequence 'in.#.exr'",),
    f"denoise in.1.exr {TO} --temporal": ("--temporal",),
    "denoise gone.#.exr -o x.#.exr --window 0": ("--window",),
    "denoise gone.#.exr -o x.#.exr --window 2 --bands 64": (
        "--bands",
        "64",
        "auto or off with --window, which takes whole frames",
    ),
    "denoise full --workers 2": ("--workers", "'full/a.exr'"),
    "denoise gone.#.exr -o x.#.exr --workers 0": ("--workers", "0"),
    "denoise gone.#.exr -o x.#.exr --workers 2 --farm tcp://a:1": ("--workers", "both"),
    "denoise gone.#.exr -o x.#.exr --insecure": ("--insecure",),
    f"denoise a.exr {TO} --farm tcp://a:1": ("--farm", "'a.exr'"),
    "denoise in.#.exr -o x.#.exr --farm tcp://host:8786": ("--farm", "'tcp://host:8786'"),
    "denoise in.#.exr -o x.#.exr --farm host:8786": ("--farm", "'host:8786'"),
    "denoise in.#.exr -o x.#.exr --farm tcp://10.0.0.7:1": ("--farm", "'tcp://10.0.0.7:1'"),
    "denoise in.#.exr -o x.#.exr --farm 'ws://[2001:db8::1]:1'": ("--farm", "'ws://[2001:db8::1]:1'"),
    "denoise in.#.exr -o x.#.exr --farm 'tcp://['": ("--farm", "'tcp://['"),
    "upsample gone.#.exr -o x.#.exr --temporal --memory 3": ("--memory", "3.0"),
    # Shading again.
    f"denoise gone.exr {TO} --adaptive 5%": ("--adaptive", "none"),
    f"upsample gone.exr {TO} --scene parlour --adaptive many": ("--adaptive", "'many'"),
    f"denoise gone.exr {TO} --scene showroom": ("--scene", "none"),
    f"denoise gone.exr {TO} --adaptive 5% --scene showrom": ("--scene", "'showrom'"),
    f"denoise gone.exr {TO} --adaptive 5% --scene parlour --light red": ("--light",),
    f"denoise gone.exr {TO} --adaptive 5% --scene parlour --adaptive-spp 0": ("--adaptive-spp",),
    # The other verbs.
    "inspect gone.exr --quality fast": ("--quality", "none"),
    "inspect gone.exr --plan --json": ("--plan", "both"),
    "inspect gone.exr --plan --radius 900": ("--radius", "900"),
    "inspect gone.exr --html gone/x.html": ("--html 'gone/x.html'",),
    "inspect a.exr --html a.exr": ("--html 'a.exr'",),
    "render showrom -o x.exr": ("scene", "'showrom'"),
    "render gone.xml -o x.exr": ("scene 'gone.xml'",),
    "render showroom -o x.#.exr --camera-path orbit": ("--camera-path", "none"),
    "render showroom -o x.#.exr --start 2": ("--start",),
    "render showroom -o x.#.exr --moving-objects": ("--moving-objects", "none"),
    "render showroom -o x.#.exr --moving-objects gone.json": ("--moving-objects", "none"),
    "render showroom -o x.#.exr --frames 2 --moving-objects gone.json": ("--moving-objects 'gone.json'",),
    "render showroom -o x.#.exr --frames 2 --aov-only": ("--frames", "both", "no --aov-only beside it"),
    "render showroom -o x.#.exr --frames 2 --place 1,1 --scale 4": ("--frames", "both", "no --place beside it"),
    "render showroom -o x.#.exr --frames 2 --reference --scale 4": ("--scale", "both", "no --reference beside it"),
    "render showroom -o x.#.exr --frames 2 --camera-path still --speed 1": ("--camera-path still",),
    "render showroom -o x.#.exr --frames 2 --camera-path orbti": ("--camera-path", "'orbti'"),
    "render showroom -o x.#.exr --frames 2 --camera-path gone.json": ("--camera-path 'gone.json'",),
    "render showroom -o gone/x.#.exr --frames 2": ("output 'gone/x.1.exr'",),
    "render showroom -o x.exr --png --aov-only": ("--aov-only", "both", "no --png beside it"),
    "render showroom -o x.exr --png --scale 2": ("--scale", "both", "no --png beside it"),
    f"render showroom {TO} -D spp=3": ("parameter 'spp'",),
    "render brushed -o x.#.exr --frames 2 --moving-objects": ("scene", "'brushed'"),
    "render gone.xml -o x.exr --spp 0": ("--spp",),
    "render gone.xml -o x.exr --aov-only --reference": ("--aov-only", "both", "no --reference beside it"),
    "render gone.xml -o x.exr --speed 2": ("--speed", "none"),
    "render parlour -o x.####.exr --frames 2 --speed nan": ("--speed", "nan"),
    "render gone.xml -o x.exr -D spp": ("-D",),
    "render gone.xml -o x.####.exr": ("--output", "'x.####.exr'"),
    "render parlour -o x.exr --frames 4": ("--output", "'x.exr'"),
    "render parlour -o gone/x.exr": ("--output 'gone/x.exr'",),
    "render parlour -o full": ("--output 'full'", "a directory"),
    "view showrom": ("scene", "'showrom'"),
    "view showroom --size big": ("--size", "'big'"),
    "view showroom --reference a.exr": ("--reference", "a scene"),
    "view showroom --preset cycles": ("--preset", "a scene"),
    "view shot.blend": ("scene", "the Blender file 'shot.blend'"),
    "view showroom --port 99999": ("--port",),
    "view brushed --moving-objects": ("scene", "'brushed'"),
    "view showroom --moving-objects gone.json": ("--moving-objects 'gone.json'",),
    "view a.exr --moving-objects": ("--moving-objects", "a finished frame"),
    "view a.exr --size 512x512": ("--size", "a finished frame"),
    "view a.exr --reference gone.exr": ("--reference 'gone.exr'",),
    "view a.exr --radius 900": ("--radius", "900"),
    "compare a.exr -r small.exr": ("image",),
    "compare a.exr -r gone.exr": ("--reference 'gone.exr'",),
    "compare in.#.exr -r a.exr": ("sequences", "single files among them"),
    "compare a.exr -r in.#.exr": ("sequences", "single files among them"),
    "compare in.#.exr a.exr -r in.#.exr": ("sequences", "single files among them"),
    "compare in.#.exr -r in.#.exr --guides a.exr": ("sequences", "single files among them"),
    "compare a.exr -r a.exr --guides in.#.exr": ("sequences", "single files among them"),
    "compare a.exr -r a.exr --guides a.exr": ("sequences", "--guides with single files"),
    "compare gone.exr -r gone.exr --json gone/x": ("--json 'gone/x'",),
    "compare gone.exr -r gone.exr --json x --html x": ("--html", "'x'"),
    "compare a.exr -r b.exr --html a.exr": ("--html 'a.exr'",),
    "compare in.#.exr -r in.#.exr --html x": ("--html", "sequences"),
    "bench --device gpu": ("--device",),
    "bench -o gone/x.json": ("--output 'gone/x.json'",),
    "bench interactive --size 512": ("--size", "'512'"),
    "bench interactive --size 0x4": ("--size", "'0x4'"),
    "bench interactive --frames 0": ("--frames", "0"),
    "bench interactive --method radiosity": ("--method",),
    "bench interactive nowhere": ("scene", "'nowhere'"),
    "bench interactive -o gone/x.json": ("--output 'gone/x.json'",),
    "bench --quick interactive": ("bench",),
    "export filter": ("--output", "neither"),
    "export filter -o x --list": ("--output", "both"),
    "export filter -o full": ("--output 'full'", "one that is not empty"),
    "export filter -o x --radius 65": ("--radius", "65"),
    "export filter -o x --name my-filter": ("--name",),
    "export filter -o x --similarity sg --anisotropic": ("--anisotropic",),
    "export pipeline --list -o x": ("--output", "both"),
    "export passes filter wgsl": ("--output", "neither"),
    "export passes filter wgls -o x": ("shader language", "'wgls'"),
    "export passes filter wgsl -o x --similarity sg_mixture": ("--similarity", "'sg_mixture'"),
    "export filter -o x --target toaster": ("--target",),
    "export pipeline -o x --plan best": ("--plan", "'best'"),
    "export pipeline -o x --plan fast --no-halves": ("halves",),
    "export pipeline -o x --plan fast --coverage": ("--coverage",),
    "export pipeline -o x --plan fast --history --similarity sg_mixture": ("--similarity", "sg_mixture with history"),
    "export pipeline -o x --plan fast --similarity diffuse": ("--similarity", "diffuse in the plan fast"),
    "export pipeline -o x --plan fast --emission --layers color": ("--emission", "one layer"),
    "export pipeline -o x --plan fast --emission --upsample 2": ("--emission", "upsampling, which has it anyway"),
    "export pipeline -o x --plan filter --history": ("--history",),
    "export pipeline -o x --hit-distance": ("--hit-distance",),
    "export functions gsl -o x": ("shader language", "'gsl'"),
    "export passes fliter wgsl -o x": ("chain",),
    "fit gone.binary -o x.lobes": ("input 'gone.binary'",),
    "fit gone.binary -o x.lobes --lobes 5": ("--lobes", "5"),
    "fit gone.binary -o x.lobes --kind asgs": ("--kind",),
    "fit gone.binary -o x.lobes --plot x.png --no-plot": ("--no-plot",),
    "fit gone.binary -o x.lobes --plot x.lobes": ("--plot",),
    "fit gone.binary -o x.lobes --plot gone/x.png": ("--plot 'gone/x.png'",),
    "fit gone.binary -o x.lobes --mitsuba gone.xml#a": ("material", "both"),
    "demo --spp 8": ("demo",),
    "demo --live --scene showrom": ("--scene", "'showrom'"),
    "demo --device gpu": ("--device",),
    "doctor --jsn": ("--jsn",),
    "doctor now": ("lobewise doctor",),
}
"""What is wrong, by the command line; also what came, and what was expected, where ``what`` is wrong in other ways."""


@pytest.fixture(scope="module")
def full_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with frames, a sequence, and files that are no renders."""
    import PyOpenColorIO

    folder = tmp_path_factory.mktemp("mistakes")
    for number, name in enumerate(("a.exr", "b.exr", "in.1.exr", "in.2.exr", "locked.exr")):
        write_frame(folder / name, make_scene((12, 16), seed=number))
    for name in ("hollow", "full", "more"):
        (folder / name).mkdir()
    for name in ("full/a.exr", "full/b.exr", "more/a.exr"):
        shutil.copy(folder / "a.exr", folder / name)
    (folder / "locked.exr").chmod(0o444)
    write_frame(folder / "nan.exr", change_radiance(make_scene((12, 16)), slice(None), slice(None), np.nan))
    write_image(folder / "small.exr", np.ones((4, 5, 3)))
    shutil.copy(FOREIGN / "blender_4.5_seed1.exr", folder / "cycles.exr")
    (folder / "empty.exr").write_bytes(b"")
    (folder / "cut.exr").write_bytes((folder / "a.exr").read_bytes()[:-100])
    (folder / "picture.png").write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(16))
    (folder / "notes.exr").write_text("notes of a scene")
    (folder / "shot.blend").write_bytes(b"BLENDER-v405")
    (folder / "picture.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(16))
    (folder / "broken.json").write_text("{")
    (folder / "notes.txt").write_text("notes")
    (folder / "raw.ocio").write_text(PyOpenColorIO.Config.CreateRaw().serialize())
    return folder


def list_content(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() if path.is_file() else b"" for path in folder.rglob("*")}


@pytest.mark.parametrize("command", MISTAKES)
def test_a_mistake_gets_one_sentence(
    command: str, full_folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(full_folder)
    monkeypatch.setenv("PATH", str(full_folder))
    monkeypatch.delenv("OCIO", raising=False)
    before = list_content(full_folder)
    fields = dict(zip(("what", "got", "expected"), MISTAKES[command], strict=False))
    problem = fail(capsys, *shlex.split(command), **fields)
    assert all((problem.expected, problem.got, problem.action))
    assert list_content(full_folder) == before
