"""Interchangeable parts by the name that a recipe uses: the recipe's schema needs their names, not their code."""

from __future__ import annotations

from forestgen.core.registry import Registry

DEFAULT_FORMATS = ("coco",)
DEFAULT_PROJECTION = "perspective"
DEFAULT_BUILDING = "house"

# In the order in which their checks run.
DATASET_FORMATS = Registry(
    "dataset format",
    {
        "depth_png": ("forestgen.dataset.formats.depth_png:FORMAT", "16-bit depth along the camera's axis"),
        "cryptomatte": ("forestgen.dataset.formats.cryptomatte:FORMAT", "coverage by name, for compositing programs"),
        "points": ("forestgen.dataset.formats.points:FORMAT", "the surfaces that pixels see as PLY and LAZ"),
        "coco": ("forestgen.dataset.formats.coco:FORMAT", "COCO instances with amodal masks and keypoints"),
        "panoptic": ("forestgen.dataset.formats.panoptic:FORMAT", "COCO panoptic: plants, ground and sky"),
        "yolo": ("forestgen.dataset.formats.yolo:FORMAT", "outlines and boxes for YOLO trainers"),
        "nerfstudio": ("forestgen.dataset.formats.nerfstudio:FORMAT", "cameras for radiance fields and splats"),
        "bop": ("forestgen.dataset.formats.bop:FORMAT", "poses, visible fractions and masks of each plant"),
    },
    contract="forestgen.dataset.formats.format:DatasetFormat",
)

PACKS = Registry(
    "pack",
    {
        "webdataset": ("forestgen.dataset.pack.webdataset:PACK", "tar files, in which files of one stem are a frame"),
        "huggingface": ("forestgen.dataset.pack.huggingface:PACK", "Parquet files for datasets.load_dataset"),
    },
    contract="forestgen.dataset.pack.pack:Pack",
)

DEFAULT_CHANNELS = ("coverage", "surface", "albedo", "sun", "cloud", "motion", "boundaries", "amodal")

# In the order in which they are made and written.
LABEL_CHANNELS = Registry(
    "label channel",
    {
        "coverage": ("forestgen.labels.channels.coverage:COVERAGE", "the ids that cover most of a pixel, their shares"),
        "surface": ("forestgen.labels.channels.surface:SURFACE", "positions, normals, triangles at pixels' centres"),
        "albedo": ("forestgen.labels.channels.surface:ALBEDO", "reflectance and transmittance of surfaces"),
        "sun": ("forestgen.labels.channels.surface:SUN", "shadows: where the sun is visible"),
        "cloud": ("forestgen.labels.channels.surface:CLOUD", "opacity of clouds"),
        "motion": ("forestgen.labels.channels.motion:CHANNEL", "pixels to the next frame of a sequence"),
        "boundaries": ("forestgen.labels.channels.boundaries:CHANNEL", "occlusion boundaries"),
        "amodal": ("forestgen.labels.channels.coverage:AMODAL", "masks of plants as if nothing stood before them"),
        "module": ("forestgen.labels.channels.surface:MODULE", "branch modules and their segments"),
    },
    contract="forestgen.labels.channels.channel:LabelChannel",
)

_WEATHER = "forestgen.atmosphere.clouds.simulated"
CLOUD_SOURCES = Registry(
    "cloud source",
    {
        "fog": (f"{_WEATHER}:FOG", "simulated weather: fog of a cooled, moist layer"),
        "stratus": (f"{_WEATHER}:STRATUS", "simulated weather: a low grey layer"),
        "stratocumulus": (f"{_WEATHER}:STRATOCUMULUS", "simulated weather: a broken layer below an inversion"),
        "cumulus": (f"{_WEATHER}:CUMULUS", "simulated weather: clouds of a heated ground"),
        "cumulonimbus": (f"{_WEATHER}:CUMULONIMBUS", "simulated weather: a thundercloud up to 8 km, with its anvil"),
        "community": ("forestgen.community.own_clouds:SOURCE", "the air that the community simulates over itself"),
        "noise": ("forestgen.atmosphere.clouds.noise:SOURCE", "small cumulus of noise, without weather"),
        "cirrus": ("forestgen.atmosphere.clouds.cirrus:SOURCE", "thin high streaks of ice, without weather"),
        "file": ("forestgen.atmosphere.clouds.saved:SOURCE", "a saved state of the air, or a field of extinction"),
        "none": ("forestgen.atmosphere.clouds.none:SOURCE", "a sky without clouds"),
    },
    contract="forestgen.atmosphere.clouds.source:CloudSource",
)

TERRAINS = Registry(
    "terrain",
    {
        "flat": ("forestgen.scene.terrains.rolling:FLAT", "flat ground"),
        "rolling": ("forestgen.scene.terrains.rolling:ROLLING", "gently rolling ground, with hills in the distance"),
        "map": ("forestgen.scene.terrains.mapped:SHAPE", "the ground of a map of heights"),
    },
    contract="forestgen.scene.terrain:TerrainShape",
)

GROUND_COVERS = Registry(
    "ground cover",
    {
        "litter": ("forestgen.scene.grounds.litter:COVER", "fallen leaves and moss"),
        "needle_litter": ("forestgen.scene.grounds.uneven:NEEDLES", "fallen needles"),
        "dead_grass": ("forestgen.scene.grounds.uneven:DEAD_GRASS", "dead grass"),
        "soil_dry": ("forestgen.scene.grounds.uneven:SOIL_DRY", "dry soil"),
        "soil_wet": ("forestgen.scene.grounds.uneven:SOIL_WET", "wet soil"),
        "soil_moist": ("forestgen.scene.grounds.uneven:SOIL_MOIST", "soil halfway between dry and wet"),
        "gravel": ("forestgen.scene.grounds.uneven:GRAVEL", "gravel"),
        "grass": ("forestgen.scene.grounds.uneven:GRASS", "grass"),
        "rock": ("forestgen.scene.grounds.uneven:ROCK", "rock"),
        "sand": ("forestgen.scene.grounds.uneven:SAND", "sand"),
        "snow": ("forestgen.scene.grounds.uneven:SNOW", "snow, also on a share of the land around"),
    },
    contract="forestgen.scene.terrain:GroundCover",
)
GROUND_OF = {
    "path": "soil_moist",
    "forest_road": "gravel",
    "strip": "grass",
    "bed": "soil_wet",
}  # by default

_LAYERS = "forestgen.scene.ground_layers"
GROUND_LAYERS = Registry(
    "ground layer",
    {
        "fallen_leaves": (f"{_LAYERS}.fallen_leaves:LAYER", "fallen leaves and needles of the stand's own species"),
        "twigs": (f"{_LAYERS}.twigs:LAYER", "dead twigs and small branches"),
        "stones": (f"{_LAYERS}.stones:LAYER", "stones and boulders"),
        "moss": (f"{_LAYERS}.moss:LAYER", "cushions and carpets of moss"),
        "bare_soil": (f"{_LAYERS}.bare_soil:LAYER", "patches where sand, soil or rock shows"),
        "small_plants": (
            f"{_LAYERS}.small_plants:LAYER",
            "small plants of a species: grass, herbs, seedlings, dwarf shrubs",
        ),
    },
    contract="forestgen.scene.ground_layers.layer:GroundLayerKind",
)

_AIR = "forestgen.scene.weather"
WEATHER = Registry(
    "weather",
    {
        "ground_fog": (f"{_AIR}.ground_fog:KIND", "fog on the ground, of a visibility and depth"),
        "rain": (f"{_AIR}.rain:KIND", "rain: streaks, dim air, wet plants and ground"),
        "snow_cover": (f"{_AIR}.snow_cover:KIND", "snow that lies on the ground and on plants"),
        "snowfall": (f"{_AIR}.snowfall:KIND", "snow that falls: flakes and dim air"),
    },
    contract="forestgen.scene.weather.kind:WeatherKind",
)

BUILDINGS = Registry(
    "building",
    {DEFAULT_BUILDING: ("forestgen.scene.buildings.house:BUILDING", "a detached house with a gable roof")},
    contract="forestgen.scene.building:BuildingKind",
)

SKIES = Registry(
    "sky model",
    {
        "clear": ("forestgen.render.skies.clear:SKY", "sun and blue sky (Hosek and Wilkie 2012)"),
        "overcast": ("forestgen.render.skies.overcast:SKY", "the CIE standard overcast sky, without a sun"),
    },
    contract="forestgen.render.skies.model:SkyModel",
)


RIGS = Registry(
    "rig",
    {
        "stereo": ("forestgen.scene.rigs.stereo:RIG", "two cameras side by side, axes parallel"),
        "orbit": ("forestgen.scene.rigs.orbit:RIG", "a circle of cameras around look_at_m"),
        "walk": ("forestgen.scene.rigs.walk:RIG", "at eye height over the ground, around trunks"),
        "drone_grid": ("forestgen.scene.rigs.drone_grid:RIG", "straight down in lines over an area, overlapping"),
    },
    contract="forestgen.scene.rigs.rig:Rig",
)

INSTRUMENTS = Registry(
    "instrument",
    {
        "light_meter": ("forestgen.instruments.light_meter:INSTRUMENT", "illuminance, colour and spectra at points"),
        "colour_chart": ("forestgen.instruments.colour_chart:INSTRUMENT", "colours against those of colour science"),
        "gap_fraction": ("forestgen.instruments.gap_fraction:INSTRUMENT", "the canopy's gaps in fisheyes that look up"),
        "stand_table": ("forestgen.instruments.stand_table:INSTRUMENT", "stems, basal area, leaf area, cover, ..."),
    },
    contract="forestgen.instruments.instrument:Instrument",
)

PROJECTIONS = Registry(
    "projection",
    {
        "perspective": ("forestgen.scene.projections.perspective:PROJECTION", "a pinhole, or a thin lens that blurs"),
        "distorted": (
            "forestgen.scene.projections.distorted:PROJECTION",
            "a pinhole through a distorting lens, as OpenCV has it",
        ),
        "fisheye": ("forestgen.scene.projections.fisheye:PROJECTION", "equidistant, up to all around"),
        "orthographic": ("forestgen.scene.projections.orthographic:PROJECTION", "parallel rays, as of a map"),
        "panorama": ("forestgen.scene.projections.panorama:PROJECTION", "equirectangular, all around, level"),
    },
    contract="forestgen.scene.projection:Projection",
)
