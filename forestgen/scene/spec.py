"""SceneSpec: everything the renderer needs, as arrays. No renderer's type in it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from forestgen.atmosphere.grid import CloudGrid
from forestgen.core.spectrum import Band, Spectrum
from forestgen.geometry.mesh import Mesh
from forestgen.plants.bark.texture import SurfaceTexture
from forestgen.plants.exemplar import Exemplar
from forestgen.recipe.exposure import Exposure
from forestgen.recipe.registries import DEFAULT_PROJECTION
from forestgen.recipe.species import LeafType


class SeasonShare(NamedTuple):
    """Leaves of one season's colour in a crown."""

    name: str
    share: float  # of the crown's leaves; may be 0
    reflectance: Spectrum
    transmittance: Spectrum | None


@dataclass(frozen=True)
class Material:
    """A surface's colour, linear Rec. 709 RGB in [0, 1]; a thin leaf also lets light through."""

    reflectance: tuple[float, float, float]
    transmittance: tuple[float, float, float] = (0.0, 0.0, 0.0)
    roughness: float = 0.5  # of the gloss
    texture: SurfaceTexture | None = None  # of a surface with uv; its mean colour is the reflectance
    gloss: float = 0.0  # share of light that a leaf's skin mirrors, part of the reflectance; see render/surfaces.py
    reflectance_spectrum: Spectrum | None = None  # of which the reflectance is the colour; None: the colour is all
    transmittance_spectrum: Spectrum | None = None
    leaf_type: LeafType | None = None  # as which its leaves vary; None: all are alike
    seasons: tuple[SeasonShare, ...] = ()  # of leaves beside each other, whose mean the spectra are
    absorption: Spectrum | None = None  # 1/m, of the water that this is the surface of; None: it is of no water
    is_wet: bool = False  # its reflectance is that under a film of water


@dataclass(frozen=True)
class Instances:
    """Where exemplars stand: one row a plant of the site, then what stands around it."""

    exemplar: NDArray[np.uint32]  # (N,) index into SceneSpec.exemplars
    transform: NDArray[np.float64]  # (N, 3, 4) exemplar frame -> world, metres
    plant_id: NDArray[np.uint32]  # (N,) 0 of what is around the site and not labelled
    outside: int = 0  # the last rows, which are of what stands around the site

    def __len__(self) -> int:
        return len(self.plant_id)

    @property
    def on_site(self) -> Instances:
        """Those of the site's plants."""
        return self.at(slice(0, len(self) - self.outside)) if self.outside else self

    def at(self, rows: slice | NDArray[np.intp] | NDArray[np.bool_]) -> Instances:
        """Those of some rows, of which none counts as outside."""
        return Instances(self.exemplar[rows], self.transform[rows], self.plant_id[rows])

    def rows_of(self, plant_ids: NDArray[np.uint32]) -> NDArray[np.intp]:
        """(M,) row of each of M plants; one that has no instance, or several, raises `ValueError`."""
        order = np.argsort(self.plant_id, kind="stable")
        placed = self.plant_id[order]
        low, high = np.searchsorted(placed, plant_ids, "left"), np.searchsorted(placed, plant_ids, "right")
        wrong = plant_ids[high - low != 1]
        if len(wrong):
            raise ValueError(f"the scene holds no instance, or several, of plants {wrong[:5].tolist()}")
        return np.asarray(order[low])


@dataclass(frozen=True)
class WetGround:
    """What water makes of a ground; scene/surfaces.py."""

    share: NDArray[np.float32]  # (V,) by vertex: 0 dry, 1 under a film of water
    reflectance: tuple[float, float, float]  # mean colour under the film, linear Rec. 709
    spectrum: Spectrum | None  # of which it is the colour; None: the colour is all


@dataclass(frozen=True, eq=False)
class GroundPart:
    """One reflectance among others on the ground's texture."""

    amount: NDArray[np.float32]  # (H, W) share of the texel times its brightness, of mean 1
    reflectance: tuple[float, float, float]  # linear Rec. 709
    spectrum: Spectrum


@dataclass(frozen=True, eq=False)
class GroundMixture:
    """What a texture of the ground consists of: each part has its own reflectance in every channel."""

    base: NDArray[np.float32]  # (H, W, 3) the ground's own texture, less what the parts hide
    reflectance: tuple[float, float, float]  # mean of the ground's own texture
    spectrum: Spectrum  # of that mean
    parts: tuple[GroundPart, ...]

    def image(self) -> NDArray[np.float32]:
        """(H, W, 3) linear Rec. 709 of all parts."""
        out = self.base.copy()
        for one in self.parts:
            out += one.amount[..., None] * np.array(one.reflectance, dtype=np.float32)
        return np.minimum(out, np.float32(1.0))


@dataclass(frozen=True, eq=False)
class GroundPatch:
    """Another ground that shows in places, such as a path's, or what is between things that lie there."""

    share: NDArray[np.float32]  # (V,) by vertex: 0 the ground around, 1 this one
    texture: NDArray[np.float32]  # (H, W, 3) linear Rec. 709 reflectance over the terrain's uv
    reflectance: tuple[float, float, float]  # mean of the texture
    spectrum: Spectrum  # of which it is the colour
    mixture: GroundMixture | None = None  # of the texture; None: it is all of one spectrum


@dataclass(frozen=True)
class Terrain:
    """The ground: a mesh with a colour texture over its uv, that gives way to one colour far from the site."""

    mesh: Mesh  # world frame, metres
    texture: NDArray[np.float32]  # (H, W, 3) linear Rec. 709 reflectance; row 0 is v = 0
    far_share: NDArray[np.float32]  # (V,) by vertex: 0 on the site, 1 in the distance
    far_reflectance: tuple[float, float, float] = (0.034, 0.050, 0.021)  # woods and meadows seen from afar
    spectrum: Spectrum | None = None  # of the texture's mean colour; None: the colour is all
    far_spectrum: Spectrum | None = None
    wet: WetGround | None = None  # None: dry, or nobody knows
    mixture: GroundMixture | None = None  # of the texture; None: it is all of one spectrum
    bare: GroundPatch | None = None  # what shows between things that are geometry; None: it is painted everywhere
    patches: tuple[GroundPatch, ...] = ()  # the later ones lie on the earlier

    @property
    def overlays(self) -> tuple[GroundPatch, ...]:
        """All other grounds, the later ones on the earlier."""
        return self.patches if self.bare is None else (self.bare, *self.patches)

    @cached_property
    def mean_colour(self) -> tuple[float, float, float]:
        """Mean of the texture, linear Rec. 709."""
        red, green, blue = (float(value) for value in self.texture.mean(axis=(0, 1), dtype=np.float64))
        return red, green, blue


@dataclass(frozen=True)
class Moon:
    """The moon in a sky."""

    elevation_deg: float
    azimuth_deg: float  # clockwise from north
    phase_angle_deg: float  # 0 full, 180 new
    distance_km: float = 384_400.0


@dataclass(frozen=True)
class Sky:
    """Sun, moon and sky by direction, haze and kind; atmosphere/daylight.py has their spectra."""

    sun_elevation_deg: float  # below 0 at night
    sun_azimuth_deg: float  # clockwise from north (y), so east (x) is 90
    turbidity: float
    ground_albedo: float = 0.2
    kind: str = "clear"  # name of its model
    altitude_m: float = 0.0  # above sea level
    sun_distance_au: float = 1.0  # from the earth
    precipitable_water_mm: float = 14.16
    ozone_du: float = 344.0  # Dobson units
    visibility_m: float | None = None  # meteorological range of the haze before the camera; None: there is none
    own: tuple[tuple[str, Any], ...] = ()  # keys of the model's own, with their values
    moon: Moon | None = None  # None: there is none

    @property
    def to_sun(self) -> NDArray[np.float64]:
        """(3,) unit vector from the site to the sun, world."""
        return towards(self.sun_elevation_deg, self.sun_azimuth_deg)

    @property
    def is_night(self) -> bool:
        """Whether the sun is below the horizon."""
        return self.sun_elevation_deg <= 0

    @property
    def moon_by_night(self) -> Moon | None:
        """The moon, where it is up and the sun is not: by day its light does not count."""
        return self.moon if self.moon is not None and self.moon.elevation_deg > 0 and self.is_night else None

    @property
    def to_light(self) -> NDArray[np.float64]:
        """(3,) unit vector to the disc that casts shadows: the sun, or by night the moon."""
        moon = self.moon_by_night
        return self.to_sun if moon is None else towards(moon.elevation_deg, moon.azimuth_deg)


def towards(elevation_deg: float, azimuth_deg: float) -> NDArray[np.float64]:
    """(3,) unit vector, world; the azimuth is clockwise from north."""
    elevation, azimuth = np.radians([elevation_deg, azimuth_deg])
    return np.array([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class Falling:
    """Drops or flakes, whose diameters above a least one have an exponential distribution."""

    number_per_m3: float  # of those above the least diameter
    least_mm: float
    mean_excess_mm: float  # of the diameters over the least one
    drift_m_per_s: tuple[float, float]  # east, north
    shutter_s: float  # of cameras without one of their own
    fall: Callable[[NDArray[np.float64]], NDArray[np.float64]]  # m/s by mm
    seen_mm: Callable[[NDArray[np.float64]], NDArray[np.float64]] | None = None  # as wide as it looks, by mm; None: so
    is_white: bool = False  # it scatters light to all sides; else it is clear


@dataclass(frozen=True)
class SnowCover:
    """Snow on sides of plants and things that face up."""

    share: float  # of level ones
    reflectance: tuple[float, float, float]  # linear Rec. 709
    spectrum: Spectrum  # of which it is the colour
    windward: tuple[float, float] = (0.0, 0.0)  # unit vector, east and north, to where the wind came from; 0: still air


@dataclass(frozen=True, eq=False)
class WetFilm:
    """A film of water on surfaces; what is under water or wet by itself is left out."""

    share: float  # how wet: 0 dry, 1 as rain makes it
    slant: tuple[float, float]  # of the rain: way east and north to a way of 1 down
    ground: NDArray[np.float32]  # (V,) by vertex of the terrain, share of the ground under a film
    pool_m: NDArray[np.float32]  # (V,) likewise, depth of the puddle there, below 0 above its level
    absorption: Spectrum  # of water, 1/m


Wave = tuple[tuple[float, float, float], float, float]  # vector in 1/m, phase and amplitude of a sine


@dataclass(frozen=True)
class FogLayer:
    """A level layer of drops that scatter and do not absorb: even up to its top, thinner by e in `fade_m` above it."""

    extinction_per_m: float
    top_m: float  # height, world
    fade_m: float
    asymmetry: float  # Henyey and Greenstein's g
    patches: tuple[Wave, ...] = ()  # of its extinction over its mean, amplitudes less than 1 together


@dataclass(frozen=True)
class Lens:
    """A thin lens: what lies off the plane of focus is blurred. Labels are those of the same rays through it."""

    aperture_radius_m: float
    focus_m: float  # distance of the plane of focus along the camera's axis


@dataclass(frozen=True)
class CameraMotion:
    """How a camera moves while it takes an image: scene/motion.py."""

    velocity_m_per_s: tuple[float, float, float]  # world
    rotation_rad_per_s: tuple[float, float, float]  # about its own axes: right, down, forward
    readout_s: float  # from the first row's exposure to the last one's, and a row more; 0: all rows together


@dataclass(frozen=True)
class Camera:
    """A camera. OpenCV axes: x right, y down, z forward; pixel centres at +0.5. scene/projection.py has its rays."""

    name: str
    position_m: tuple[float, float, float]
    world_from_camera: NDArray[np.float64]  # (3, 3) rotation; columns are the camera's axes in the world
    size_px: tuple[int, int]  # width, height
    hfov_deg: float  # across the width; unused by projections that have no such angle
    sequence: str | None = None  # cameras of one name are the frames of a path, in their order
    time_s: float = 0.0  # in its sequence; plants stand as the wind holds them then
    projection: str = DEFAULT_PROJECTION  # its registered name; scene/projection.py finds it
    width_m: float = 0.0  # of parallel rays: of the image, in the world
    lens: Lens | None = None  # None is a pinhole
    bands: tuple[Band, ...] = ()  # what its sensor answers to; none: colour, linear Rec. 709
    exposure: Exposure | None = None  # for a raw-like image beside the linear one
    numbers: Mapping[str, float] = field(default_factory=dict)  # what else its projection needs
    motion: CameraMotion | None = None  # None: it stands still; where there is one, there is an exposure

    @property
    def focal_px(self) -> float:
        """Focal length in pixels, the same along x and y: pixels are square. Of a pinhole."""
        return self.size_px[0] / 2.0 / float(np.tan(np.radians(self.hfov_deg) / 2.0))

    @property
    def pixel_slopes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """x / z of the rays through the columns' centres, (W,), and y / z through the rows', (H,); camera's axes."""
        width, height = self.size_px
        columns, rows = np.arange(width, dtype=np.float64) + 0.5, np.arange(height, dtype=np.float64) + 0.5
        return (columns - width / 2) / self.focal_px, (rows - height / 2) / self.focal_px


@dataclass(frozen=True)
class SceneSpec:
    """A scene that can be rendered, counted, written to disk or exported."""

    exemplars: tuple[Exemplar, ...]
    materials: Mapping[tuple[str, str], Material]  # (species, material key of its organ meshes) -> material
    instances: Instances
    terrain: Terrain
    sky: Sky
    clouds: CloudGrid | None
    cameras: tuple[Camera, ...]
    fog: tuple[FogLayer, ...] = ()  # what light goes through near the ground
    snow: SnowCover | None = None  # on plants; None: there is none
    film: WetFilm | None = None  # None: all is dry, or as wet as its materials are
    falling: tuple[Falling, ...] = ()  # what falls before the cameras
    bark_spread: float = 0.0  # of wood's reflectance between plants: scene/bark_tones.py
