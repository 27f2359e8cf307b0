"""A scene in Blender Cycles, for benchmarks/radiance.py: `python cycles_scene.py SCENE.npz`, in a Python that has bpy.

Builds the scene once and then reads requests from its standard input, one a line: samples, seed, "tree" or "flat"
(how a light is chosen), "sampled" or "found" (whether light samples go to the sky too), and the file for the picture.
Answers `REPLY seconds`, of all processors, for one rendering; Blender itself prints other lines.
"""

from __future__ import annotations

import resource
import sys

import numpy as np

try:
    import bpy
    import mathutils
except ImportError:
    print("REPLY absent", flush=True)
    sys.exit()

SCALE = 1e-3  # of light: Cycles' pictures are in klx-like units, near 1
BOUNCES = 64


def node(tree, kind, **inputs):
    made = tree.nodes.new(kind)
    for name, value in inputs.items():
        made.inputs[name].default_value = value
    return made


def rgba(colour):
    return (*(float(value) for value in colour), 1.0)


def material(name, reflectance, transmittance):
    """Matt; a leaf passes light evenly too. Each lobe is chosen as often as its share of the light."""
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    surface = node(tree, "ShaderNodeOutputMaterial").inputs["Surface"]
    share = float(transmittance.max() / (reflectance.max() + transmittance.max()))
    matt = node(tree, "ShaderNodeBsdfDiffuse", Color=rgba(reflectance / (1 - share)), Roughness=0.0)
    if share == 0:
        tree.links.new(matt.outputs[0], surface)
        return made
    through = node(tree, "ShaderNodeBsdfTranslucent", Color=rgba(transmittance / share))
    mix = node(tree, "ShaderNodeMixShader", Fac=share)
    tree.links.new(matt.outputs[0], mix.inputs[1])
    tree.links.new(through.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], surface)
    return made


def mesh(name, vertices, faces, materials, of_face=None):
    """Flat facets."""
    made = bpy.data.meshes.new(name)
    made.vertices.add(len(vertices))
    made.vertices.foreach_set("co", vertices.ravel())
    made.loops.add(faces.size)
    made.loops.foreach_set("vertex_index", faces.ravel())
    made.polygons.add(len(faces))
    made.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    for one in materials:
        made.materials.append(one)
    if of_face is not None:
        made.polygons.foreach_set("material_index", of_face.astype(np.int32))
    made.update(calc_edges=True)
    return made


def placed(name, data, matrix):
    made = bpy.data.objects.new(name, data)
    made.matrix_world = mathutils.Matrix(matrix.tolist())
    bpy.context.scene.collection.objects.link(made)
    return made


def build_plants(scene):
    materials = [material(f"m{k}", r, t) for k, (r, t) in enumerate(zip(scene["r"], scene["t"], strict=True))]
    exemplars = {}
    for key in np.unique(scene["exemplar"]):
        used, local = np.unique(scene[f"m{key}"], return_inverse=True)
        own = [materials[index] for index in used]
        exemplars[key] = mesh(f"e{key}", scene[f"v{key}"], scene[f"f{key}"], own, local)
    for row, (key, part) in enumerate(zip(scene["exemplar"], scene["transform"], strict=True)):
        placed(f"i{row}", exemplars[key], np.vstack([part, [0, 0, 0, 1]]))
    ground = material("ground", scene["ground"], np.zeros(3))
    placed("ground", mesh("ground", scene["ground_v"], scene["ground_f"], [ground]), np.eye(4))


def build_sky(scene):
    """Our map has rows at the poles and columns from x over y; Blender's starts below and turns the other way."""
    ours = scene["sky"]
    height, width, _ = ours.shape
    azimuth = (0.5 - (np.arange(width) + 0.5) / width) * 2 * np.pi
    column = (np.mod(azimuth, 2 * np.pi) / (2 * np.pi) * width).astype(int) % width
    at = (1 - (np.arange(height) + 0.5) / height) * (height - 1)
    low = np.clip(np.floor(at).astype(int), 0, height - 2)
    part = (at - low)[:, None, None]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = (ours[low] * (1 - part) + ours[low + 1] * part)[:, column] * SCALE
    image = bpy.data.images.new("sky", width, height, float_buffer=True, is_data=True)
    image.pixels.foreach_set(pixels.ravel())
    world = bpy.data.worlds.new("world")
    bpy.context.scene.world = world
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    environment = node(tree, "ShaderNodeTexEnvironment")
    environment.image = image
    background = node(tree, "ShaderNodeBackground")
    tree.links.new(environment.outputs["Color"], background.inputs["Color"])
    tree.links.new(background.outputs[0], node(tree, "ShaderNodeOutputWorld").inputs["Surface"])


def build_sun(scene):
    light = bpy.data.lights.new("sun", "SUN")
    light.angle = float(scene["sun_angle"])
    irradiance = scene["sun_irradiance"] * SCALE
    light.energy = float(irradiance.max())
    light.color = [float(value) for value in irradiance / irradiance.max()]
    placed("sun", light, np.eye(4)).rotation_euler = (
        mathutils.Vector(scene["to_sun"].tolist()).to_track_quat("Z", "Y").to_euler()
    )


def build_camera(scene):
    data = bpy.data.cameras.new("camera")
    data.sensor_fit, data.angle_x = "HORIZONTAL", float(scene["hfov"])
    data.clip_start, data.clip_end = 0.01, 1e7
    matrix = np.eye(4)
    matrix[:3, :3] = scene["world_from_camera"] * [1.0, -1.0, -1.0]
    bpy.context.scene.camera = placed("camera", data, matrix)


def settings(scene):
    render, cycles = bpy.context.scene.render, bpy.context.scene.cycles
    render.resolution_x, render.resolution_y = (int(value) for value in scene["size_px"])
    render.resolution_percentage = 100
    render.use_persistent_data = True
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    bpy.context.scene.view_settings.view_transform = "Raw"
    cycles.device = "CPU"
    cycles.use_adaptive_sampling = cycles.use_denoising = cycles.use_auto_tile = False
    for name in ("max", "diffuse", "transmission", "glossy", "transparent_max"):
        setattr(cycles, f"{name}_bounces", BOUNCES)
    cycles.sample_clamp_indirect = cycles.sample_clamp_direct = 0.0
    cycles.pixel_filter_type = "BOX"


def take(samples, seed, tree, sky, path):
    """Seconds of all processors; the picture goes to `path` as an array, (H, W, 3), its first row above."""
    scene = bpy.context.scene
    scene.cycles.samples, scene.cycles.seed = samples, seed
    scene.cycles.use_light_tree = tree == "tree"
    method = "AUTOMATIC" if sky == "sampled" else "NONE"
    if scene.world.cycles.sampling_method != method:
        scene.world.cycles.sampling_method = method
        scene.world.update_tag()  # else what is kept stays as it was
    scene.render.filepath = f"{path}.exr"
    before = resource.getrusage(resource.RUSAGE_SELF)
    bpy.ops.render.render(write_still=True)
    after = resource.getrusage(resource.RUSAGE_SELF)
    image = bpy.data.images.load(f"{path}.exr")
    image.colorspace_settings.name = "Non-Color"
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)
    bpy.data.images.remove(image)
    np.save(path, pixels.reshape(height, width, 4)[::-1, :, :3] / SCALE)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main():
    scene = np.load(sys.argv[1])
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.render.engine = "CYCLES"
    build_plants(scene)
    build_sky(scene)
    build_sun(scene)
    build_camera(scene)
    settings(scene)
    print("REPLY ready", bpy.app.version_string, flush=True)
    for line in sys.stdin:
        samples, seed, tree, sky, path = line.split(maxsplit=4)
        print("REPLY", take(int(samples), int(seed), tree, sky, path.strip()), flush=True)


main()
