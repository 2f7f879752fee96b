"""What the buttons do: denoise, cancel, and switch passes on."""

from contextlib import contextmanager
from pathlib import Path

import bpy
from bpy.props import BoolProperty, StringProperty

from .process import Denoising, list_frames, list_options, name_output, name_pattern

SECONDS_BETWEEN_LOOKS = 0.25
MULTILAYER = {"file_format": "OPEN_EXR_MULTILAYER", "color_depth": "32", "exr_codec": "ZIP"}
PASSES = (
    *("z", "position", "normal", "emit", "environment", "cryptomatte_object"),
    *(f"{lobe}_{part}" for lobe in ("diffuse", "glossy", "transmission") for part in ("direct", "indirect", "color")),
)
"""The passes that lobewise reads, beside Denoising Data, which Cycles has for itself."""
FIRST_VERSION_WITH_ROUGHNESS = (5, 2, 0)
"""Earlier versions have no roughness in Denoising Data."""
ROUGHNESS = "Roughness"
running = []
"""The work that is done now, one at most."""


def list_missing_passes(scene, layer):
    """Return (owner, property) of every pass of a view layer that lobewise reads and that is off."""
    wanted = [(layer, f"use_pass_{name}") for name in PASSES]
    wanted.append((layer.cycles, "denoising_store_passes"))
    if scene.lobewise.window and not scene.render.use_motion_blur:
        wanted.append((layer, "use_pass_vector"))
    return [(owner, name) for owner, name in wanted if not getattr(owner, name)]


@contextmanager
def multilayer_output(scene):
    """Let renders be saved as multilayer EXR with all bits, and restore the user's format at the end."""
    settings = scene.render.image_settings
    wanted = {**({"media_type": "MULTI_LAYER_IMAGE"} if hasattr(settings, "media_type") else {}), **MULTILAYER}
    if scene.render.use_multiview:
        wanted["views_format"] = "MULTIVIEW"
    # The format decides which of the others are allowed, so that it is restored first.
    before = {name: getattr(settings, name) for name in (*wanted, "color_mode")}
    try:
        for name, value in wanted.items():
            setattr(settings, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(settings, name, value)


def save_render(scene):
    """Save the render result with all its passes for this session, and return the file."""
    path = Path(bpy.app.tempdir, "lobewise", f"{bpy.path.clean_name(scene.name)}.exr")
    path.parent.mkdir(exist_ok=True)
    result = bpy.data.images.get("Render Result")
    if result is None:
        raise ValueError("There is no render yet: render an image first.")
    try:
        with multilayer_output(scene):
            try:
                result.save_render(str(path), scene=scene)
            except RuntimeError:
                # Blender 4.5 notices views only after a first try, which leaves a file for each.
                if not scene.render.use_multiview:
                    raise
                for view in scene.render.views:
                    if view.file_suffix:
                        path.with_stem(path.stem + view.file_suffix).unlink(missing_ok=True)
                result.save_render(str(path), scene=scene)
    except RuntimeError as problem:
        words = str(problem).removeprefix("Error: ").strip()
        raise ValueError(f"Blender cannot save the render: {words}; render an image first.") from problem
    return path


def locate_animation(scene):
    """Return the pattern of the frames that Render Animation writes."""
    render = scene.render
    if render.image_settings.file_format != MULTILAYER["file_format"]:
        raise ValueError(
            "The output is no multilayer EXR: choose that in the tab Output, and render the animation again."
        )
    if render.use_multiview and render.image_settings.views_format != "MULTIVIEW":
        raise ValueError(
            "The output has a file for each eye: choose Multi-View as Views Format in the tab Output, "
            "and render the animation again."
        )
    pattern = Path(name_pattern(render.frame_path(frame=1), render.frame_path(frame=999999)))
    if not list_frames(pattern):
        raise FileNotFoundError(f"There is no frame {pattern}: render the animation first.")
    return pattern


def locate_shown(context):
    """Return the file of the image that an image editor shows; None for the render result."""
    image = getattr(context.space_data, "image", None)
    if image is None or image.type == "RENDER_RESULT" or not image.filepath:
        return None
    return Path(image.filepath_from_user())


def load_result(output):
    """Return the image of a result, and how many frames it has."""
    frames = list_frames(output)
    image = bpy.data.images.load(str(frames[0]), check_existing=True)
    image.use_view_as_render = True
    if "#" in output.name:
        image.source = "SEQUENCE"
    image.reload()
    return image, len(frames)


def show_beside(context, image, frames):
    """Show an image in an image editor that has none, or shows this one; else split an editor in two."""
    editors = [each for each in context.screen.areas if each.type == "IMAGE_EDITOR"]
    free = [each for each in editors if each.spaces.active.image in (None, image)]
    if editors and not free:
        known = {each.as_pointer() for each in context.screen.areas}
        with context.temp_override(area=editors[0]):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
        free = [each for each in context.screen.areas if each.as_pointer() not in known]
    for space in [each.spaces.active for each in free[:1]]:
        space.image = image
        space.image_user.frame_duration = frames
        space.image_user.use_auto_refresh = True


class LOBEWISE_OT_denoise(bpy.types.Operator):
    """Write a clean copy of the shown render or file, and show it beside the noisy one"""

    bl_idname = "lobewise.denoise"
    bl_label = "Denoise with lobewise"

    filepath: StringProperty(
        name="File", description="A multilayer EXR file; by default the image that is shown", subtype="FILE_PATH"
    )
    animation: BoolProperty(name="Animation", description="Denoise all frames in the output folder")

    @classmethod
    def poll(cls, context):
        return not running

    def start(self, context):
        """Start the process, and return whether there is anything to denoise."""
        scene, settings = context.scene, context.scene.lobewise
        layers = [layer for layer in scene.view_layers if layer.use]
        options = list_options(
            quality=settings.quality,
            passes=settings.passes,
            window=settings.window if self.animation else 0,
            light_groups=settings.light_groups,
            all_layers=len(layers) > 1,
        )
        try:
            source = self.locate_source(context)
            self.work = Denoising(source, name_output(source), options)
        except (OSError, ValueError) as problem:
            self.report({"ERROR"}, str(problem))
            return False
        running.append(self.work)
        return True

    def locate_source(self, context):
        """Return the file to denoise, or the pattern of an animation; the render result is saved in a file."""
        self.saved = None
        if self.animation:
            return locate_animation(context.scene)
        shown = Path(self.filepath) if self.filepath else locate_shown(context)
        if shown is None:
            shown = self.saved = save_render(context.scene)
        return shown

    def finish(self, context):
        """Report what the program said, and show the result."""
        running.clear()
        if self.saved:
            self.saved.unlink()
        is_done, messages = self.work.take_messages()
        if not is_done:
            kind = "WARNING" if self.work.is_cancelled else "ERROR"
            self.report({kind}, messages[-1] if messages else "lobewise was ended from outside.")
            return {"CANCELLED"}
        for message in messages:
            self.report({"INFO"}, message)
        image, frames = load_result(self.work.output)
        if not bpy.app.background:
            show_beside(context, image, frames)
        self.report({"INFO"}, f"Denoised: {image.filepath}")
        return {"FINISHED"}

    def execute(self, context):
        """Denoise, and return when it is done."""
        if not self.start(context):
            return {"CANCELLED"}
        self.work.wait()
        return self.finish(context)

    def invoke(self, context, event):
        """Denoise while Blender goes on."""
        if not self.start(context):
            return {"CANCELLED"}
        self.timer = context.window_manager.event_timer_add(SECONDS_BETWEEN_LOOKS, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        """Look at the process from time to time; Esc ends it."""
        if event.type == "ESC" and event.value == "PRESS":
            self.work.cancel()
        elif event.type != "TIMER":
            return {"PASS_THROUGH"}
        is_done = self.work.is_done()
        words, _ = self.work.describe()
        context.workspace.status_text_set(None if is_done else f"lobewise: {words}. Esc cancels.")
        for area in context.screen.areas:
            area.tag_redraw()
        if not is_done:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self.timer)
        return self.finish(context)

    def cancel(self, context):
        """End the process, because Blender ends or opens another file."""
        self.work.cancel()
        running.clear()


class LOBEWISE_OT_cancel(bpy.types.Operator):
    """Stop denoising. Frames that are written stay"""

    bl_idname = "lobewise.cancel"
    bl_label = "Cancel"

    @classmethod
    def poll(cls, context):
        return bool(running)

    def execute(self, context):
        """End the process; its own operator reports this."""
        running[0].cancel()
        return {"FINISHED"}


class LOBEWISE_OT_switch_on_passes(bpy.types.Operator):
    """Switch on the passes that lobewise reads and that are off in this view layer"""

    bl_idname = "lobewise.switch_on_passes"
    bl_label = "Switch On Missing Passes"
    bl_options = {"REGISTER", "UNDO"}

    roughness: BoolProperty(
        name="Roughness of Materials",
        description="Before Blender 5.2, add an output of the roughness to every Principled BSDF",
    )

    @classmethod
    def poll(cls, context):
        return context.scene.render.engine == "CYCLES"

    def execute(self, context):
        """Switch on what is missing, and say what that was."""
        layer = context.view_layer
        missing = list_missing_passes(context.scene, layer)
        for owner, name in missing:
            setattr(owner, name, True)
        if self.roughness and bpy.app.version < FIRST_VERSION_WITH_ROUGHNESS:
            write_roughness(layer)
        self.report({"INFO"}, f"Passes that are on now: {len(missing)}. Render again to have them.")
        return {"FINISHED"}


def write_roughness(layer):
    """Add a pass of the roughness to a view layer, and to every material an output that fills it."""
    if ROUGHNESS not in layer.aovs:
        aov = layer.aovs.add()
        aov.name, aov.type = ROUGHNESS, "VALUE"
    for tree in [material.node_tree for material in bpy.data.materials if material.node_tree]:
        if any(node.type == "OUTPUT_AOV" and node.aov_name == ROUGHNESS for node in tree.nodes):
            continue
        for shader in [node for node in tree.nodes if node.type == "BSDF_PRINCIPLED"][:1]:
            written = tree.nodes.new("ShaderNodeOutputAOV")
            written.aov_name = ROUGHNESS
            roughness = shader.inputs["Roughness"]
            written.inputs["Value"].default_value = roughness.default_value
            if roughness.is_linked:
                tree.links.new(roughness.links[0].from_socket, written.inputs["Value"])
