"""The public names of rendering; each module is imported when one of its names is first used."""

from .camera import get_camera as get_camera
from .camera import set_camera as set_camera
from .camera_path import find_orbit_centre as find_orbit_centre
from .camera_path import make_orbit as make_orbit
from .camera_path import read_camera_path as read_camera_path
from .loading import MovingScene as MovingScene
from .loading import list_moving_scenes as list_moving_scenes
from .loading import list_scenes as list_scenes
from .loading import load_scene as load_scene
from .materials.lookup import open_scene_material as open_scene_material
from .moving.object_paths import ObjectPaths as ObjectPaths
from .moving.object_paths import PlacedScene as PlacedScene
from .moving.object_paths import read_object_paths as read_object_paths
from .renderer import render_frame as render_frame
from .renderer import render_pixels as render_pixels
from .renderer import render_reference as render_reference
from .renderer import render_sparse_frame as render_sparse_frame
from .sequence import render_sequence as render_sequence
from .variant import load_mitsuba as load_mitsuba
