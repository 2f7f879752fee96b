"""The settings, the panels that show them, and the entries of menus."""

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty

from .operators import (
    FIRST_VERSION_WITH_ROUGHNESS,
    ROUGHNESS,
    LOBEWISE_OT_cancel,
    LOBEWISE_OT_denoise,
    LOBEWISE_OT_switch_on_passes,
    list_missing_passes,
    running,
)

MAX_WINDOW = 8


class LobewiseSettings(bpy.types.PropertyGroup):
    """What a scene's renders are denoised with."""

    quality: EnumProperty(
        name="Quality",
        items=(
            ("AUTO", "Auto", "What pays: mixed with Open Image Denoise where the extension brings it"),
            ("BEST", "Best", "A little less noise, for half as much time again; needs Open Image Denoise"),
            ("HIGH", "High", "Averages of pixels alone, with weights of a network: nothing is invented"),
            ("BALANCED", "Balanced", "Averages of pixels alone, quicker"),
            ("FAST", "Fast", "Weights by the guides alone"),
        ),
    )
    passes: EnumProperty(
        name="Passes",
        items=(
            ("REPLACE", "Replace", "The clean passes take the places of the noisy ones"),
            ("BESIDE", "Add", "The clean passes stand beside the noisy ones, as Combined_clean and so on"),
            ("ONLY", "Clean Only", "Only the clean passes are written"),
        ),
    )
    light_groups: BoolProperty(name="Light Groups", description="Denoise the light groups as well", default=True)
    window: IntProperty(
        name="Frame Window",
        description="Frames before and after that every frame of an animation uses; needs the pass Vector",
        max=MAX_WINDOW,
        min=0,
    )


def draw_entries(menu, context):
    """Draw the entries of a menu."""
    menu.layout.separator()
    menu.layout.operator_context = "INVOKE_DEFAULT"
    menu.layout.operator(LOBEWISE_OT_denoise.bl_idname)
    entry = menu.layout.operator(LOBEWISE_OT_denoise.bl_idname, text="Denoise Animation with lobewise")
    entry.animation = True


class SettingsPanel:
    """Both panels: one in image editors, one in the tab Render."""

    bl_label = "lobewise"

    def draw(self, context):
        """Draw the settings, the missing passes, and the buttons or the progress."""
        scene, layout = context.scene, self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        for name in ("quality", "passes", "window"):
            layout.prop(scene.lobewise, name)
        row = layout.row()
        row.active = any(len(layer.lightgroups) for layer in scene.view_layers)
        row.prop(scene.lobewise, "light_groups")
        self.draw_passes(context)
        if not running:
            layout.operator(LOBEWISE_OT_denoise.bl_idname)
            layout.operator(LOBEWISE_OT_denoise.bl_idname, text="Denoise Animation").animation = True
            return
        words, share = running[0].describe()
        layout.progress(text=words, factor=share)
        layout.operator(LOBEWISE_OT_cancel.bl_idname)

    def draw_passes(self, context):
        """Draw how many passes are missing, and the button that switches them on."""
        if context.scene.render.engine != "CYCLES":
            self.layout.label(text="lobewise reads the passes of Cycles", icon="INFO")
            return
        if missing := list_missing_passes(context.scene, context.view_layer):
            self.layout.label(text=f"Passes that are off: {len(missing)}", icon="INFO")
            self.layout.operator(LOBEWISE_OT_switch_on_passes.bl_idname)
        if bpy.app.version < FIRST_VERSION_WITH_ROUGHNESS and ROUGHNESS not in context.view_layer.aovs:
            button = self.layout.operator(LOBEWISE_OT_switch_on_passes.bl_idname, text="Write Roughness")
            button.roughness = True


class LOBEWISE_PT_image(SettingsPanel, bpy.types.Panel):
    bl_space_type, bl_region_type, bl_category = "IMAGE_EDITOR", "UI", "lobewise"


class LOBEWISE_PT_render(SettingsPanel, bpy.types.Panel):
    bl_space_type, bl_region_type, bl_context = "PROPERTIES", "WINDOW", "render"
    bl_options = {"DEFAULT_CLOSED"}
