"""Denoises the render result, multilayer EXR files and rendered animations with lobewise, inside Blender."""

import bpy

from .operators import LOBEWISE_OT_cancel, LOBEWISE_OT_denoise, LOBEWISE_OT_switch_on_passes
from .panel import LOBEWISE_PT_image, LOBEWISE_PT_render, LobewiseSettings, draw_entries

CLASSES = (
    LobewiseSettings,
    LOBEWISE_OT_cancel,
    LOBEWISE_OT_denoise,
    LOBEWISE_OT_switch_on_passes,
    LOBEWISE_PT_image,
    LOBEWISE_PT_render,
)
MENUS = (bpy.types.IMAGE_MT_image, bpy.types.TOPBAR_MT_render)


def register():
    """Add the settings to scenes, the panels, and the entries of the menus Image and Render."""
    for each in CLASSES:
        bpy.utils.register_class(each)
    bpy.types.Scene.lobewise = bpy.props.PointerProperty(type=LobewiseSettings)
    for menu in MENUS:
        menu.append(draw_entries)


def unregister():
    """Take back what `register` added."""
    for menu in MENUS:
        menu.remove(draw_entries)
    del bpy.types.Scene.lobewise
    for each in reversed(CLASSES):
        bpy.utils.unregister_class(each)
