"""What artists do wrong at the command line: one sentence each, which blames no file for an option."""

import re
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.io import write_frame, write_image
from tests.streaming.frames import change_radiance, make_scene

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
TO = "-o x.exr"
"""An output that could be written, beside an input that is not there where an option is wrong."""
LONG = "x" * 300 + ".exr"
"""A longer name than file systems keep."""

MISTAKES = {
    # Verbs and names of options.
    "denois a.exr": "verb: expected one of demo, render, view, denoise, …; did you mean 'denoise'?",
    "help": "verb: expected one of demo, …; choose one of them.",
    "a.exr": "verb: expected one before the file, got 'a.exr'; such as lobewise denoise a.exr.",
    "--radius 3 a.exr": "--radius: expected an option of lobewise, got none of that name; write it behind a verb.",
    "export": "lobewise export: expected one of pipeline, filter, functions, passes, got none; see lobewise export --",
    "export web": "lobewise export: expected one of pipeline, filter, functions, passes, got 'web'; ",
    "export --plan fast --list": "--plan: expected an option of lobewise export, got none of that name; write it b",
    "bench fast": "lobewise bench: expected one of interactive, got 'fast'; ",
    f"denoise gone.exr {TO} --similarty sg": "--similarty: expected an option of lobewise denoise, …; did you mean --s",
    "export passes filter wgsl -o x --radius 3": "--radius: expected an option of lobewise export passes, got none of ",
    "compare a.exr -r b.exr --metric psnr": "--metric: expected an option of lobewise compare, …; see lobewise ",
    # Words that are missing, or too many.
    "denoise": "lobewise denoise: expected INPUT.exr... behind it, got none; see lobewise denoise --help.",
    "denoise a.exr -o": "-o: expected a value behind it, got none; see lobewise denoise --help.",
    f"denoise gone.exr {TO} --radius": "--radius: expected a value behind it, got none; see lobewise denoise --help.",
    "denoise a.exr --overwrite=yes": "--overwrite: expected no value behind it, got 'yes'; see lobewise denoise ",
    "upsample a.exr": "--output: expected FILE, got none; add --output FILE, or see lobewise upsample --help.",
    "compare a.exr b.exr": "--reference: expected FILE, got none; add --reference FILE, or see lobewise compare ",
    "inspect a.exr b.exr": "lobewise inspect: expected only INPUT.exr, got 'b.exr' as well; see lobewise inspect ",
    "devices cuda": "lobewise devices: expected only options, got 'cuda' as well; see lobewise devices --help.",
    "export passes filter -o x": "lobewise export passes: expected hlsl|glsl|wgsl behind it, got none; see lobewise ",
    "fit -o x.lobes": "material: expected either MATERIAL.binary or --mitsuba SCENE#ID, got neither; ",
    # Values of the filter's options.
    f"denoise gone.exr {TO} --radius wide": "--radius: expected a whole number, got 'wide'; see lobewise denoise ",
    f"denoise gone.exr {TO} --radius -1": "--radius: expected an integer from 0 to 64, got -1; 8 is usual; form atrous",
    f"denoise gone.exr {TO} --radius=900": "--radius: expected an integer from 0 to 64, got 900; ",
    f"denoise gone.exr {TO} --beta strong": "--beta: expected \"auto\" or a finite number above 0, got 'strong'; ",
    f"denoise gone.exr {TO} --beta nan": '--beta: expected "auto" or a finite number above 0, got nan; ',
    f"denoise gone.exr {TO} --lobes 9": "--lobes: expected an integer from 1 to 4, got 9; 3 is usual.",
    f"denoise gone.exr {TO} --quality balancd": "--quality: expected one of …, got 'balancd'; did you mean 'balanced'?",
    f"denoise gone.exr {TO} --similarity gxx": "--similarity: expected one of …, got 'gxx'; did you mean 'ggx'?",
    f"denoise gone.exr {TO} --form ful": "--form: expected one of …, got 'ful'; did you mean 'full'?",
    f"denoise gone.exr {TO} --form atrous --quality high": "--form: expected 'full' with quality 'high', got ",
    f"denoise gone.exr {TO} --device gpu": "--device: expected one of auto, cpu, vulkan, cuda, metal, got 'gpu'; ",
    f"denoise gone.exr {TO} --device metal": "--device: expected one that runs here, got metal; ",
    f"denoise gone.exr {TO} --with-oidn --quality fast": "--quality: expected 'balanced' or 'high' with Open Image ",
    f"denoise gone.exr {TO} --with-oidn --form atrous": "--form: expected 'full' with quality 'balanced', got 'atrous'",
    f"denoise gone.exr {TO} --bands odd": "--bands: expected auto, off or a number of rows, got 'odd'; leave it out.",
    f"denoise gone.exr {TO} --bands 0": "--bands: expected auto, off or a number of rows, got 0; leave it out.",
    f"denoise gone.exr {TO} --bands -4": "--bands: expected auto, off or a number of rows, got '-4'; leave it out.",
    f"denoise gone.exr {TO} --bands 9 --with-oidn": "--bands: expected auto or off with --with-oidn, which takes ",
    f"denoise gone.exr {TO} --bands 9 --adaptive 5% --scene showroom": "--bands: expected …--adaptive, which ",
    f"denoise gone.exr {TO} --bands 64 --only": "--bands: expected auto or off with --only, which takes whole frames, ",
    f"denoise gone.exr {TO} --max-memory lots": "--max-memory: expected a size of at least 1GiB, such as 8GB, got ",
    f"denoise gone.exr {TO} --max-memory 100MB": "--max-memory: expected a size of at least 1GiB, such as 8GB, got ",
    f"denoise gone.exr {TO} --max-seconds soon": "--max-seconds: expected a number, got 'soon'; ",
    f"upsample gone.exr {TO} --max-seconds 0": "--max-seconds: expected a number above 0, got 0; ",
    f"denoise gone.exr {TO} --material gone.lobes": "--material 'gone.lobes': expected an existing file, ",
    f"upsample gone.exr {TO} --scale 99": "--scale: expected an integer from 1 to 16, got 99; ",
    f"upsample gone.exr {TO} --place 1": "--place: expected ROW,COLUMN, such as 1,2, got '1'; ",
    f"upsample gone.exr {TO} --scale 2 --place 0,2": "--place: expected row and column from 0 to 1, got (0, 2); ",
    f"upsample gone.exr {TO} --radius 99": "--radius: expected an integer from 0 to 64, got 99; ",
    f"upsample gone.exr {TO} --memory 0.5": "--memory: expected --temporal beside it, got none; add --temporal.",
    f"upsample gone.exr {TO} --temporal --bilinear": "--bilinear: expected no --temporal beside it, got both; ",
    f"denoise gone.exr {TO} --wrap --bands 16": "--bands: expected auto or off with --wrap, which takes whole frames, ",
    # What the file holds.
    f"denoise gone.exr {TO} --preset cyclse": "--preset: expected one of …, got 'cyclse'; did you mean 'cycles'?",
    f"denoise gone.exr {TO} --preset gone.toml": "--preset 'gone.toml': expected an existing file, got no such file; ",
    f"denoise gone.exr {TO} --map normal": "--map: expected ROLE=CHANNELS, each role once, got 'normal'; write, ",
    f"denoise gone.exr {TO} --map nomral=N": "--map: expected one of color, …, got 'nomral'; did you mean 'normal'?",
    "inspect gone.exr --map normal=N:cube": "--map normal, conversion: expected one of camera_space, …, got 'cube'; ",
    f"denoise cycles.exr {TO} --map normal=N.X,N.Y,N.Z": "--map normal: expected channels or a pass ",
    f"denoise cycles.exr {TO} --map normal=Foo": "--map normal: expected …, got 'Foo'; `lobewise inspect --all` lists",
    f"denoise cycles.exr {TO} --map normal=Normall": "--map normal: …, got 'Normall'; the nearest are 'ViewLayer.Norm",
    f"denoise cycles.exr {TO} --map normal=ViewLayer.Normal.X": "--map normal: expected 3 channels, ",
    f"denoise cycles.exr {TO} --also AO": "--also AO: expected passes …, got no such pass; see ",
    f"denoise a.exr {TO} --also AO": "--also: expected a file of another renderer, got a file with ",
    f"denoise gone.exr {TO} --camera broken.json": "--camera 'broken.json': expected JSON, got text that is no JSON: ",
    f"denoise gone.exr {TO} --camera notes.txt": "--camera 'notes.txt': expected a name that ends in .json, .xml, ",
    f"denoise a.exr {TO} --half a.exr": "--half: expected a second image with other noise, got the same ",
    f"denoise a.exr {TO} --half small.exr": "--half: expected the same frame rendered again, 16x12 pixels, got 5x4 ",
    f"denoise a.exr {TO} --half gone.exr": "--half 'gone.exr': expected an existing file, got no such file; ",
    "denoise full --half b.exr": "--half: expected one input beside it, got 2 inputs; denoise them one by one.",
    "denoise in.#.exr -o x.#.exr --half a.exr": "--half: expected a sequence for a sequence, and a file for a file, ",
    # Inputs.
    f"denoise gone.exr {TO}": "input 'gone.exr': expected an existing file, got no such file; check the path.",
    "denoise smal.exr": "input 'smal.exr': expected an existing file, got no such file; did you mean 'small.exr'?",
    "denoise a.exr x.exr": "input 'x.exr': expected an existing file, got no such file; ",
    "denoise '*.exr'": "input '*.exr': expected an existing file, got no such file; name files, a folder, or a ",
    "denoise ~/a.exr": "input '~/a.exr': expected an existing file, …; write out the folder, or leave the quotes out, ",
    "denoise $SHOT/a.exr": "input '$SHOT/a.exr': expected an existing file, …; write out the folder, or leave the ",
    r"denoise 'C:\shots\a.exr'": r"input 'C:\\shots\\a.exr': expected an existing file, …; write / between folders, ",
    "denoise '\"gone.exr\"'": "input '\"gone.exr\"': expected an existing file, …; leave the quotation marks out.",
    "denoise hollow": "input 'hollow': expected EXR files in the folder, got none; name files.",
    "inspect hollow": "input 'hollow': expected a file, got a directory; name a file in it.",
    f"render shot.blend {TO}": "scene: expected a Mitsuba XML file, got the Blender file 'shot.blend'; render it in ",
    f"denoise notes.exr {TO}": "input 'notes.exr': expected a whole …, got a file that …; name an image that a render",
    "denoise a.exr -o clean": "--output: expected a name that ends in .exr, …, got 'clean'; name it 'clean.exr'.",
    f"denoise picture.png {TO}": "input 'picture.png': expected an OpenEXR file, got a PNG picture; save the render ",
    "denoise picture.jpg": "input 'picture.jpg': expected an OpenEXR file, got a JPEG picture; save the render as ",
    f"denoise empty.exr {TO}": "input 'empty.exr': expected an image, got an empty file of 0 bytes; write it again.",
    f"denoise cut.exr {TO}": "input 'cut.exr': expected a whole OpenEXR file, got a truncated file of ",
    "denoise --png cut.exr": "input 'cut.exr': expected a whole OpenEXR file, got a truncated file of ",
    "denoise cut.exr -o cut.exr --overwrite": "input 'cut.exr': expected a whole OpenEXR file, got a truncated ",
    f"denoise a.exr --half cut.exr {TO}": "--half 'cut.exr': expected a whole OpenEXR file, got a truncated file of ",
    f"denoise nan.exr {TO} --bands off": "input 'nan.exr': radiance: expected at least one pixel that is finite ",
    f"denoise nan.exr {TO} --bands 9": "input 'nan.exr': radiance: expected at least one pixel that is finite ",
    f"denoise gone.exr {TO} --bands 9": "input 'gone.exr': expected an existing file, got no such file; ",
    "inspect cut.exr": "input 'cut.exr': expected a whole OpenEXR file, got a truncated file of ",
    "denoise -": "--output: expected a file, or -, got none; add -o FILE.",
    "denoise - a.exr -o full/": "input: expected one input where - is given, got 2; ",
    f"upsample a.exr {TO}": "input 'a.exr': expected the attribute lobewise/sparse with scale, row and column, got ",
    f"upsample cycles.exr {TO}": "input 'cycles.exr': expected --scale for a file of another renderer, whose header ",
    "upsample in.#.exr -o x.#.exr": "input 'in.1.exr': expected the attribute lobewise/sparse with scale, row and ",
    f"inspect {LONG}": "input 'xxx…xxx.exr': expected a readable file, got file name too long; check the path.",
    f"denoise {LONG} {TO}": "input 'xxx…xxx.exr': expected a readable file, got file name too long; check the path.",
    f"upsample {LONG} {TO}": "input 'xxx…xxx.exr': expected a readable file, got file name too long; check the path.",
    f"view {LONG}": "input 'xxx…xxx.exr': expected a readable file, got file name too long; check the path.",
    f"fit {LONG} -o x.lobes": "input 'xxx…xxx.exr': expected a readable file, got file name too long; check the path.",
    # Outputs.
    f"render showroom -o {LONG}": "--output 'xxx…xxx.exr': expected a path that can be written, got file name too long",
    f"export filter -o {LONG}": "--output 'xxx…xxx.exr': expected a new or empty folder, got file name too long; ",
    "upsample a.exr -o b.exr/": "--output 'b.exr/': expected a file name, got a name that ends with a slash, ",
    "inspect a.exr --html b.exr/": "--html 'b.exr/': expected a file name, got a name that ends with a slash, ",
    "compare a.exr -r a.exr --json b.exr/": "--json 'b.exr/': expected a file name, got a name that ends with a ",
    "fit gone.binary -o b.exr/": "--output 'b.exr/': expected a file name, got a name that ends with a slash, ",
    "denoise gone.exr -o x.png": "--output: expected a name that ends in .exr, …, got 'x.png'; name it 'x.exr'.",
    "upsample gone.exr -o x.jpg": "--output: expected a name that ends in .exr, …, got 'x.jpg'; name it 'x.exr'.",
    "render showroom -o x.png": "--output: expected a name that ends in .exr, …, got 'x.png'; name it 'x.exr'.",
    "denoise gone.exr -o gone/x.exr": "--output 'gone/x.exr': expected a path that can be written, got no folder ",
    "upsample a.exr -o full": "--output 'full': expected a file name, got a directory; name a file in it.",
    "denoise gone.exr -o a.exr/x.exr": "--output 'a.exr/x.exr': expected a path that can be written, got ",
    "denoise gone.exr -o locked.exr": "--output 'locked.exr': expected a file that can be replaced, got a read-only ",
    "denoise a.exr -o a.exr": "--output 'a.exr': expected a file that is not read, …; choose another name, or add ",
    "denoise full -o full": "output 'full/a.exr': expected a file that is not read, as its content would be lost, ",
    "denoise full -o x.exr": "--output: expected a folder for the 2 inputs, got the file 'x.exr'; name a folder.",
    "denoise full/a.exr more/a.exr -o x": "inputs: expected one for each output, got two for 'x/a.exr'; give them ",
    "denoise a.exr a.exr": "inputs: expected one for each output, got two for 'a_clean.exr'; give them one by one.",
    "denoise a.exr -o clean.####.exr": "--output: expected the name of one file for the one input 'a.exr', got ",
    "upsample a.exr -o 'clean.$F4.exr'": "--output: expected the name of one file for the one input 'a.exr', got ",
    "demo -o a.exr": "--output 'a.exr': expected a folder that can be made, got file exists; choose another folder.",
    f"denoise gone.exr {TO} --exposure 1": "--exposure: expected --png beside it, got none; add --png.",
    f"denoise gone.exr {TO} --png --exposure 99": "--exposure: expected a number from -64 to 64, got 99; try 0.",
    f"denoise gone.exr {TO} --png --exposure nan": "--exposure: expected a number from -64 to 64, got nan; try 0.",
    f"denoise gone.exr {TO} --view AgX": "--view: expected --png beside it, got none; add --png.",
    f"denoise gone.exr {TO} --png --view AgX": "--ocio: expected a configuration of OpenColorIO beside --display and ",
    f"denoise gone.exr {TO} --png --ocio gone.ocio": "--ocio 'gone.ocio': expected a configuration of OpenColorIO, ",
    f"denoise gone.exr {TO} --png --ocio raw.ocio --display tv": "--display: expected one of sRGB, got 'tv'; ",
    f"upsample gone.exr {TO} --png --ocio raw.ocio --view Row": "--view: expected one of Raw, got 'Row'; did you mean ",
    "denoise gone.exr -o - --png": "--png: expected files as input and output, got '-'; name files.",
    f"denoise gone.exr {TO} --tev": "--tev: expected the program tev, got none on the PATH; install it from ",
    # Sequences.
    f"denoise in.#{LONG} -o x.#.exr": "sequence 'in.#xxx…xxx.exr': expected files such as 'in.1xxx…xxx.exr', got none",
    "denoise in.#.exr -o x.#.exr --temporal --bands 9": "--bands: expected auto or off with --temporal, which takes ",
    "denoise gone.#.exr -o x.#.exr": "sequence 'gone.#.exr': expected files such as 'gone.1.exr', got none; ",
    "denoise gone.#.exr -o x.exr": "--output: expected a sequence such as 'in.####.exr', got 'x.exr'; put # in place ",
    "denoise in.#.exr -o x.#.exr --overwrite": "--overwrite: expected a single file, got the sequence 'in.#.exr', ",
    f"denoise gone.exr {TO} --frames 1-3": "--frames: expected a sequence such as 'in.####.exr', got 'gone.exr'; put ",
    "denoise gone.#.exr -o x.#.exr --frames 3-1": "--frames: expected at most 1000000 frames, such as 1001-1050, ",
    "denoise in.#.exr -o x.#.exr --frames 1-2 --png": "--png: expected --exposure beside --frames, so that all ",
    "denoise in.#.exr -o x.#.exr --frames 2-4": "sequence 'in.#.exr': expected every frame …, got no file of frames ",
    f"denoise in.1.exr {TO} --temporal": "--temporal: expected a sequence such as 'in.####.exr', got 'in.1.exr'; put ",
    "denoise gone.#.exr -o x.#.exr --window 0": "--window: expected 1 to 8 frames, got 0; 2 is usual.",
    "denoise gone.#.exr -o x.#.exr --window 2 --bands 64": "--bands: expected auto or off with --window, which takes ",
    "denoise full --workers 2": "--workers: expected a sequence such as 'in.####.exr', got 'full/a.exr'; put # in ",
    "denoise gone.#.exr -o x.#.exr --workers 0": "--workers: expected a number from 1 to 1024, got 0; try the number ",
    "denoise gone.#.exr -o x.#.exr --workers 2 --farm tcp://a:1": "--workers: expected no --farm beside it, got both; ",
    "denoise gone.#.exr -o x.#.exr --insecure": "--insecure: expected --farm beside it, got none; leave it out.",
    f"denoise a.exr {TO} --farm tcp://a:1": "--farm: expected a sequence such as 'in.####.exr', got 'a.exr'; put # ",
    "denoise in.#.exr -o x.#.exr --farm tcp://host:8786": "--farm: expected …; give Dask certificates, or add ",
    "denoise in.#.exr -o x.#.exr --farm host:8786": "--farm: expected an address that begins with tls://, or one of ",
    "denoise in.#.exr -o x.#.exr --farm tcp://10.0.0.7:1": "--farm: expected an address that begins with tls://, or ",
    "denoise in.#.exr -o x.#.exr --farm 'ws://[2001:db8::1]:1'": "--farm: expected an address that begins with ",
    "denoise in.#.exr -o x.#.exr --farm 'tcp://['": "--farm: expected an address that begins with tls://, or one of ",
    "upsample gone.#.exr -o x.#.exr --temporal --memory 3": "--memory: expected a number from 0 to 1, got 3.0; ",
    # Shading again.
    f"denoise gone.exr {TO} --adaptive 5%": "--adaptive: expected --scene beside it, got none; name the scene.",
    f"upsample gone.exr {TO} --scene parlour --adaptive many": "--adaptive: expected 0% to 100%, got 'many'; 5% ",
    f"denoise gone.exr {TO} --scene showroom": "--scene: expected --adaptive beside it, got none; add --adaptive 5%.",
    f"denoise gone.exr {TO} --adaptive 5% --scene showrom": "--scene: expected one of …, got 'showrom'; did you mean ",
    f"denoise gone.exr {TO} --adaptive 5% --scene parlour --light red": "--light: expected one of all, indirect, got ",
    f"denoise gone.exr {TO} --adaptive 5% --scene parlour --adaptive-spp 0": "--adaptive-spp: expected 1 to 65536, or",
    # The other verbs.
    "inspect gone.exr --quality fast": "--quality: expected --plan beside it, got none; add --plan.",
    "inspect gone.exr --plan --json": "--plan: expected no --json beside it, got both; leave one of them out.",
    "inspect gone.exr --plan --radius 900": "--radius: expected an integer from 0 to 64, got 900; ",
    "inspect gone.exr --html gone/x.html": "--html 'gone/x.html': expected a path that can be written, got no folder ",
    "inspect a.exr --html a.exr": "--html 'a.exr': expected a file that is not read, as its content would be lost, ",
    "render showrom -o x.exr": "scene: expected one of showroom, …, got 'showrom'; did you mean 'showroom'?",
    "render gone.xml -o x.exr": "scene 'gone.xml': expected an existing file, got no such file; check the path.",
    "render showroom -o x.#.exr --camera-path orbit": "--camera-path: expected --frames beside it, got none; ",
    "render showroom -o x.#.exr --start 2": "--start: expected --frames beside it, got none; say how many frames.",
    "render showroom -o x.#.exr --moving-objects": "--moving-objects: expected --frames beside it, got none; say ",
    "render showroom -o x.#.exr --moving-objects gone.json": "--moving-objects: expected --frames beside it, got none;",
    "render showroom -o x.#.exr --frames 2 --moving-objects gone.json": "--moving-objects 'gone.json': expected an exi",
    "render showroom -o x.#.exr --frames 2 --aov-only": "--frames: expected no --aov-only beside it, got both; ",
    "render showroom -o x.#.exr --frames 2 --place 1,1 --scale 4": "--frames: expected no --place beside it, got both;",
    "render showroom -o x.#.exr --frames 2 --reference --scale 4": "--scale: expected no --reference beside it, got ",
    "render showroom -o x.#.exr --frames 2 --camera-path still --speed 1": "--camera-path still: expected no --speed ",
    "render showroom -o x.#.exr --frames 2 --camera-path orbti": "--camera-path: expected one of orbit, still, got ",
    "render showroom -o x.#.exr --frames 2 --camera-path gone.json": "--camera-path 'gone.json': expected an existing ",
    "render showroom -o gone/x.#.exr --frames 2": "output 'gone/x.1.exr': expected a path that can be written, got no ",
    "render showroom -o x.exr --png --aov-only": "--aov-only: expected no --png beside it, got both; leave one ",
    "render showroom -o x.exr --png --scale 2": "--scale: expected no --png beside it, got both; leave one of them ",
    f"render showroom {TO} -D spp=3": "parameter 'spp': expected an XML file, got the scene 'showroom'; leave it out: ",
    "render brushed -o x.#.exr --frames 2 --moving-objects": "scene: expected one …: showroom or parlour, got ",
    "render gone.xml -o x.exr --spp 0": "--spp: expected a number …, got '0'; see lobewise re",
    "render gone.xml -o x.exr --aov-only --reference": "--aov-only: expected no --reference beside it, got both; ",
    "render gone.xml -o x.exr --speed 2": "--speed: expected --frames beside it, got none; say how many frames.",
    "render parlour -o x.####.exr --frames 2 --speed nan": "--speed: expected a finite number, got nan; 0.25 is usual.",
    "render gone.xml -o x.exr -D spp": "-D: expected NAME=VALUE, such as spp=16, got 'spp'; write both.",
    "render gone.xml -o x.####.exr": "--output: expected --frames beside a name with # for the number, got ",
    "render parlour -o x.exr --frames 4": "--output: expected a sequence such as 'in.####.exr', got 'x.exr'; put # in ",
    "render parlour -o gone/x.exr": "--output 'gone/x.exr': expected a path that can be written, got no folder ",
    "render parlour -o full": "--output 'full': expected a file name, got a directory; ",
    "view showrom": "scene: expected one of showroom, …, got 'showrom'; did you mean 'showroom'?",
    "view showroom --size big": "--size: expected columns x rows from 8 to 8192, such as 512x512, got 'big'; ",
    "view showroom --reference a.exr": "--reference: expected a finished frame beside it, got a scene; leave it out.",
    "view showroom --preset cycles": "--preset: expected a finished frame beside it, got a scene; leave it out.",
    "view shot.blend": "scene: expected a Mitsuba XML file, got the Blender file 'shot.blend'; render it in Blender",
    "view showroom --port 99999": "--port: expected a number …, got '99999'; see lobewise ",
    "view brushed --moving-objects": "scene: expected one whose objects move: showroom or parlour, got 'brushed'; ",
    "view showroom --moving-objects gone.json": "--moving-objects 'gone.json': expected an existing file, got no such ",
    "view a.exr --moving-objects": "--moving-objects: expected a scene beside it, got a finished frame; leave it out.",
    "view a.exr --size 512x512": "--size: expected a scene beside it, got a finished frame; leave it out.",
    "view a.exr --reference gone.exr": "--reference 'gone.exr': expected an existing file, got no such file; ",
    "view a.exr --radius 900": "--radius: expected an integer from 0 to 64, got 900; ",
    "compare a.exr -r small.exr": "input 'a.exr': image: expected the size of the reference, 5x4 pixels, got 16x12; ",
    "compare a.exr -r gone.exr": "--reference 'gone.exr': expected an existing file, got no such file; check the path.",
    "compare in.#.exr -r a.exr": "sequences: expected names such as a.####.exr for all that is compared, got single ",
    "compare a.exr -r in.#.exr": "sequences: expected names such as a.####.exr for all …, got single files ",
    "compare in.#.exr a.exr -r in.#.exr": "sequences: expected names such as a.####.exr for all …, got single files ",
    "compare in.#.exr -r in.#.exr --guides a.exr": "sequences: expected names …, got single files ",
    "compare a.exr -r a.exr --guides in.#.exr": "sequences: expected names …, got single files ",
    "compare a.exr -r a.exr --guides a.exr": "sequences: expected names such as …, got --guides with single files; ",
    "compare gone.exr -r gone.exr --json gone/x": "--json 'gone/x': expected a path that can be written, got no ",
    "compare gone.exr -r gone.exr --json x --html x": "--html: expected another file than that of --json, got 'x'; ",
    "compare a.exr -r b.exr --html a.exr": "--html 'a.exr': expected a file that is not read, as its content would be ",
    "compare in.#.exr -r in.#.exr --html x": "--html: expected single files, got sequences; name one frame of each.",
    "bench --device gpu": "--device: expected one of auto, cpu, vulkan, cuda, metal, got 'gpu'; did you mean 'cpu'?",
    "bench -o gone/x.json": "--output 'gone/x.json': expected a path that can be written, got no folder ",
    "bench interactive --size 512": "--size: expected columns x rows from 8 to 8192, such as 512x512, got '512'; ",
    "bench interactive --size 0x4": "--size: expected columns x rows from 8 to 8192, such as 512x512, got '0x4'; ",
    "bench interactive --frames 0": "--frames: expected at least 1, got 0; 24 is usual.",
    "bench interactive --method radiosity": "--method: expected one of paths, …, got 'radiosity'; choose one of them.",
    "bench interactive nowhere": "scene: expected one of showroom, …, got 'nowhere'; choose one of them.",
    "bench interactive -o gone/x.json": "--output 'gone/x.json': expected a path that can be written, got no folder ",
    "bench --quick interactive": "bench: expected its options behind `interactive`, got some before it; ",
    "export filter": "--output: expected a folder to write, or --list, which writes nothing, got neither; ",
    "export filter -o x --list": "--output: expected a folder to write, or --list, which writes nothing, got both; ",
    "export filter -o full": "--output 'full': expected a new or empty folder, got one that is not empty; ",
    "export filter -o x --radius 65": "--radius: expected an integer from 0 to 64, got 65; ",
    "export filter -o x --name my-filter": "--name: expected an identifier of C, got 'my-filter'; ",
    "export filter -o x --similarity sg --anisotropic": "--anisotropic: expected what a pipeline can contain …, got sg",
    "export pipeline --list -o x": "--output: expected a folder to write, or --list, which writes nothing, got both; ",
    "export passes filter wgsl": "--output: expected a folder to write, or --list, which writes nothing, got neither; ",
    "export passes filter wgls -o x": "shader language: expected one of hlsl, glsl, wgsl, got 'wgls'; did you mean ",
    "export passes filter wgsl -o x --similarity asg": "--similarity: expected one of ggx, sg, got 'asg'; ",
    "export filter -o x --target toaster": "--target: expected host, or processor-bits-system and features, ",
    "export pipeline -o x --plan best": "--plan: expected one of filter, fast, balanced, high, got 'best'; ",
    "export pipeline -o x --plan fast --no-halves": "halves: expected what …, got in one pass, which reads none; ",
    "export pipeline -o x --plan balanced --hit-guides --layers color": "--hit-guides: expected what …, got what ",
    "export pipeline -o x --plan fast --coverage": "--coverage: expected what …, got in one pass; add upsampling, ",
    "export pipeline -o x --plan fast --history --similarity sg_mixture": "--similarity: expected what …, got sg_",
    "export pipeline -o x --plan fast --similarity diffuse": "--similarity: expected what …; choose the plan filter.",
    "export pipeline -o x --plan fast --emission --layers color": "--emission: expected what …, got one layer; ",
    "export pipeline -o x --plan fast --emission --upsample 2": "--emission: expected what …, got upsampling, ",
    "export pipeline -o x --plan filter --history": "--history: expected what …, got history with the plan filter; ",
    "export pipeline -o x --similarity normal --hit-distance": "--hit-distance: expected …; choose a similarity of ",
    "export functions gsl -o x": "shader language: expected one of hlsl, glsl, wgsl, got 'gsl'; did you mean 'wgsl'?",
    "export passes fliter wgsl -o x": "chain: expected one of …, got 'fliter'; did you mean 'filter'?",
    "fit gone.binary -o x.lobes": "input 'gone.binary': expected an existing file, got no such file; check the path.",
    "fit gone.binary -o x.lobes --lobes 5": "--lobes: expected an integer from 1 to 4, got 5; ",
    "fit gone.binary -o x.lobes --kind asgs": "--kind: expected one of sg, asg, got 'asgs'; did you mean 'asg'?",
    "fit gone.binary -o x.lobes --plot x.png --no-plot": "--no-plot: expected no --plot beside it, got both; ",
    "fit gone.binary -o x.lobes --plot x.lobes": "--plot: expected another file than the output, got 'x.lobes'; ",
    "fit gone.binary -o x.lobes --plot gone/x.png": "--plot 'gone/x.png': expected a path that can be written, got no ",
    "fit gone.binary -o x.lobes --mitsuba gone.xml#a": "material: expected either MATERIAL.binary or --mitsuba ",
    "demo --spp 8": "demo: expected --live beside the options of rendering, got none; add --live, which needs Mitsuba.",
    "demo --live --scene showrom": "--scene: expected one of showroom, …, got 'showrom'; did you mean 'showroom'?",
    "demo --device gpu": "--device: expected one of auto, cpu, vulkan, cuda, metal, got 'gpu'; did you mean 'cpu'?",
    "doctor --jsn": "--jsn: expected an option of lobewise doctor, got none of that name; did you mean --json?",
    "doctor now": "lobewise doctor: expected only options, got 'now' as well; see lobewise doctor --help.",
}
"""What the sentence begins with, by the command line; … stands for any words."""


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
    (folder / "picture.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(16))
    (folder / "broken.json").write_text("{")
    (folder / "notes.txt").write_text("notes")
    (folder / "notes.exr").write_text("notes of a scene")
    (folder / "shot.blend").write_bytes(b"BLENDER-v405")
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
    assert run(shlex.split(command)) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert re.match(".*".join(map(re.escape, f"lobewise: {MISTAKES[command]}".split("…"))), err), err
    assert re.fullmatch(r"lobewise: .+: expected .+, got .+; .+[.?]\n", err), err
    assert list_content(full_folder) == before
