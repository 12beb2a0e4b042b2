"""Files as ocean models write them: several for one field, curvilinear and staggered grids."""

from pathlib import Path

import numpy as np
import pytest
from scipy.io import netcdf_file
from substep import CurvilinearField, FormatError, GridField, InputError, advect, open_field
from substep.fields import ACTIVE

OCEAN = Path(__file__).parents[3] / "shared" / "data" / "globcurrent"
needs_ocean = pytest.mark.skipif(not OCEAN.is_dir(), reason=f"no ocean currents at {OCEAN}")
DAY = 86400.0


def write(path, variables, dimensions):
    """A NetCDF file of {name: (dimensions, values, attributes)}."""
    with netcdf_file(path, "w") as file:
        for name, length in dimensions.items():
            file.createDimension(name, length)
        for name, (along, values, attributes) in variables.items():
            variable = file.createVariable(name, "d", along)
            variable[:] = values
            for key, value in attributes.items():
                setattr(variable, key, value)
    return path


def nemo(path, name, lon, lat, values, times, depth=None, **more):
    """One velocity as NEMO writes it: nav_lon and nav_lat (y, x), time_counter, perhaps a depth."""
    dimensions = {"y": lon.shape[0], "x": lon.shape[1], "time_counter": len(times)}
    along = ("time_counter", "y", "x")
    variables = {
        "nav_lon": (("y", "x"), lon, {"units": "degrees_east"}),
        "nav_lat": (("y", "x"), lat, {"units": "degrees_north"}),
        "time_counter": (("time_counter",), times, more),
    }
    if depth is not None:
        axis, layers = depth
        dimensions[axis] = len(layers)
        along = ("time_counter", axis, "y", "x")
        variables[axis] = ((axis,), layers, {"units": "m"})
    variables[name] = (along, values, {"units": "m/s"})
    return write(path, variables, dimensions)


def bent(n, m):
    """Points (y, x) of a curvilinear grid, for numbers that need not be whole."""

    def at(j, i):
        i, j = np.meshgrid(i, j)
        return 10 + 0.5 * i + 0.1 * j + 0.02 * i * j / m, 40 + 0.4 * j - 0.08 * i

    return at, np.arange(n), np.arange(m)


def stream(lon, lat):
    return 1e4 * (np.sin(0.5 * lon) + np.cos(0.7 * lat))


def speeds(lon, lat, axis):
    """What goes through the faces between points along an axis, of the stream function."""
    dx, dy = (np.diff(a, axis=axis) for a in (lon, lat))
    middle = np.radians(lat.take(range(1, lat.shape[axis]), axis) - dy / 2)
    length = np.radians(6371008.8 * np.hypot(dx * np.cos(middle), dy))
    return np.diff(stream(lon, lat), axis=axis) / length


class TestSeveralFiles:
    @needs_ocean
    def test_the_ocean_with_u_and_v_in_files_of_their_own(self, tmp_path):
        # As Parcels' tutorials ship theirs: the same numbers, and the same drift to the bit.
        for path in sorted(OCEAN.iterdir())[:4]:
            with netcdf_file(path, mmap=False) as file:
                for name in ("eastward", "northward"):
                    full = f"{name}_eulerian_current_velocity"
                    kept = {n: file.variables[n] for n in ("lon", "lat", "time", full)}
                    write(
                        tmp_path / f"{path.stem}{name[0]}.nc",
                        {
                            n: (v.dimensions, v[:], {k: a for k, a in v._attributes.items()})
                            for n, v in kept.items()
                        },
                        {n: kept[n].shape[0] for n in ("lon", "lat", "time")},
                    )
        ours, theirs = open_field(tmp_path), open_field(sorted(OCEAN.iterdir())[:4])
        assert ours.times.tolist() == theirs.times.tolist() and ours.origin == theirs.origin
        start = np.random.default_rng(0).uniform(*theirs.bounds, (500, 2))
        one, two = (advect(f, start, (0, 3 * DAY), step=3600) for f in (ours, theirs))
        assert one.final.tobytes() == two.final.tobytes() and (one.status == two.status).all()

    def test_straight_rows_in_two_dimensions_make_axes(self, tmp_path):
        # Parcels' moving eddies: nav_lon and nav_lat as (y, x), of a grid that is rectilinear.
        lon, lat = np.meshgrid(np.linspace(0, 4, 9), np.linspace(45, 48, 7))
        times = [0.0, 86400.0]
        u, v = np.full((2, 1, 7, 9), 0.5), np.full((2, 1, 7, 9), -0.25)
        depth = ("deptht", [0.0])
        nemo(tmp_path / "eddiesU.nc", "vozocrtx", lon, lat, u, times, depth)
        nemo(tmp_path / "eddiesV.nc", "vomecrty", lon, lat, v, times, depth)
        nemo(tmp_path / "eddiesP.nc", "P", lon, lat, v, times, depth)
        for given in (
            tmp_path,
            str(tmp_path / "*.nc"),
            [tmp_path / "eddiesU.nc", tmp_path / "eddiesV.nc"],
        ):
            field = open_field(given)
            assert isinstance(field, GridField) and field.geographic and field.origin is None
            assert field.times.tolist() == [0, 86400]
            assert field(3600, [[1.3, 46.0]]).tolist() == [[0.5, -0.25]]
            assert [name[-11:] for name in field.sources] == ["/eddiesU.nc", "/eddiesV.nc"]
        with pytest.raises(InputError, match=r"eddiesP\.nc, which has"):
            open_field([tmp_path / f"eddies{c}.nc" for c in "UVP"])

    def test_what_is_missing_or_does_not_go_together_is_named(self, tmp_path):
        lon, lat = np.meshgrid(np.linspace(0, 4, 9), np.linspace(45, 48, 7))
        u = nemo(tmp_path / "u.nc", "vozocrtx", lon, lat, np.zeros((2, 7, 9)), [0.0, 1.0])
        with pytest.raises(InputError, match="no velocity along y"):
            open_field(u)
        late = nemo(tmp_path / "v.nc", "vomecrty", lon, lat, np.zeros((2, 7, 9)), [0.0, 2.0])
        with pytest.raises(FormatError, match=r"v\.nc: its times are not those of .*u\.nc"):
            open_field([u, late])
        dated = nemo(
            tmp_path / "d.nc", "vomecrty", lon, lat, np.zeros((2, 7, 9)), [0.0, 1.0],
            units="seconds since 2000-01-01",
        )  # fmt: skip
        with pytest.raises(FormatError, match="times are not those"):
            open_field([u, dated])
        far = nemo(tmp_path / "f.nc", "vomecrty", lon + 2.2, lat, np.zeros((2, 7, 9)), [0.0, 1.0])
        with pytest.raises(FormatError, match=r"4\.4 and 0 cells beside"):
            open_field([u, far])
        other = nemo(
            tmp_path / "o.nc", "vomecrty", lon[:6], lat[:6], np.zeros((2, 6, 9)), [0.0, 1.0]
        )
        with pytest.raises(FormatError, match="of another shape"):
            open_field([u, other])


class TestCurvilinear:
    def test_at_the_same_points(self, tmp_path):
        at, j, i = bent(8, 10)
        lon, lat = at(j, i)
        nemo(tmp_path / "u.nc", "uo", lon, lat, (lon + lat)[None], [0.0])
        nemo(tmp_path / "v.nc", "vo", lon, lat, (lon - lat)[None], [0.0])
        field = open_field(tmp_path)
        assert isinstance(field, CurvilinearField) and field.arakawa == "A"
        x = np.array([[lon[3:5, 4:6].mean(), lat[3:5, 4:6].mean()]])
        assert field(0, x)[0] == pytest.approx([x.sum(), x[0, 0] - x[0, 1]], abs=1e-9)
        with pytest.raises(InputError, match="linear alone"):
            open_field(tmp_path, interpolation="cubic")

    def test_points_that_no_model_computed_are_left_out(self, tmp_path):
        at, j, i = bent(8, 10)
        lon, lat = at(j, i)
        x = [[lon[3:5, 4:6].mean(), lat[3:5, 4:6].mean()]]
        lon[5:, :3] = lat[5:, :3] = 0  # NEMO without its subdomains of land
        nemo(tmp_path / "u.nc", "uo", lon, lat, np.ones((1, 8, 10)), [0.0])
        nemo(tmp_path / "v.nc", "vo", lon, lat, np.ones((1, 8, 10)), [0.0])
        field = open_field(tmp_path)
        assert field(0, x).tolist() == [[1.0, 1.0]]
        assert np.isnan(field(0, [[5.0, 20.0]])).all()

    @pytest.mark.parametrize("layout", ["nemo", "mesh", "south-west"])
    def test_staggered_velocities_follow_the_stream_function(self, tmp_path, layout):
        # NEMO: U(j, i) lies half a cell east of T(j, i), V north, the corner f(j, i) north-east.
        at, j, i = bent(12, 14)
        east = 0.5 if layout != "south-west" else -0.5
        u_points, v_points = at(j, i + east), at(j + east, i)
        corners = at(j + east, i + east)
        # Faces lie between corners; those of the first or last cells reach beyond the arrays.
        longer = (np.append(j + east, j[-1] + 1 + east), np.append(i + east, i[-1] + 1 + east))
        if east > 0:
            longer = tuple(a - 1 for a in longer)
        lon, lat = at(*longer)
        flow_u, flow_v = speeds(lon, lat, 0), -speeds(lon, lat, 1)
        u = flow_u[:, 1:] if east > 0 else flow_u[:, :-1]
        v = flow_v[1:] if east > 0 else flow_v[:-1]
        nemo(tmp_path / "a_grid_U.nc", "vozocrtx", *u_points, u[None], [0.0])
        nemo(tmp_path / "a_grid_V.nc", "vomecrty", *v_points, v[None], [0.0])
        if layout == "mesh":
            write(
                tmp_path / "coordinates.nc",
                {
                    "glamf": (("t", "y", "x"), corners[0][None], {}),
                    "gphif": (("t", "y", "x"), corners[1][None], {}),
                },
                {"t": 1, "y": 12, "x": 14},
            )
        field = open_field(tmp_path)
        assert isinstance(field, CurvilinearField) and field.arakawa == "C"
        # On a mesh that is given the corners are exact; half way between points nearly.
        inner = (slice(1, -1), slice(1, -1))
        known = set(np.round(np.stack(corners, -1)[inner].reshape(-1, 2), 6).ravel().tolist())
        got = set(np.round(np.stack([field.x, field.y], -1).reshape(-1, 2), 6).ravel().tolist())
        assert known <= got if layout == "mesh" else len(known & got) >= len(known) // 3
        start = np.random.default_rng(0).uniform([12.5, 41.5], [14.5, 43], (100, 2))
        drift = advect(field, start, (0, 20 * DAY), step=1200)
        moved = np.abs(drift.final - start).max()
        change = np.abs(stream(*drift.final.T) - stream(*start.T))
        assert (drift.status == ACTIVE).sum() > 60 and moved > 0.5
        assert change[drift.status == ACTIVE].max() < 0.06 * np.ptp(stream(*start.T))

    def test_in_space(self, tmp_path):
        at, j, i = bent(6, 7)
        faces = [0.0, 10.0, 30.0]
        shape = (1, 3, 6, 7)
        layers = np.broadcast_to(np.array([1.0, 2.0, 3.0])[:, None, None], shape)
        nemo(tmp_path / "U.nc", "vozocrtx", *at(j, i + 0.5), layers, [0.0], ("depthu", [5, 20, 40]))
        nemo(
            tmp_path / "V.nc",
            "vomecrty",
            *at(j + 0.5, i),
            0 * layers,
            [0.0],
            ("depthv", [5, 20, 40]),
        )
        up = np.broadcast_to(np.array(faces)[:, None, None], shape)
        nemo(tmp_path / "W.nc", "vovecrtz", *at(j, i), up, [0.0], ("depthw", faces))
        field = open_field(tmp_path)
        x = np.array([12.0, 41.0])
        u = field(0, [[*x, 4.0], [*x, 25.0]])
        assert field.dimension == 3 and u[:, 2] == pytest.approx([-4.0, -25.0])  # depth is down
        assert u[1, :2] == pytest.approx(2 * u[0, :2], rel=1e-9) and np.hypot(*u[0, :2]) > 0.5
        (tmp_path / "W.nc").unlink()
        with pytest.raises(FormatError, match="give depth="):
            open_field(tmp_path)
        flat = open_field(tmp_path, depth=19.0)
        assert flat.dimension == 2 and flat(0, [x])[0] == pytest.approx(u[1, :2])

    def test_round_the_earth(self, tmp_path):
        # 72 columns without a seam: the cell from the last to the first is there too.
        lon, lat = np.meshgrid(np.arange(2.5, 360, 5), np.linspace(-60, 60, 25))
        lat = lat + 2 * np.sin(np.radians(lon))
        nemo(tmp_path / "u.nc", "uo", lon, lat, np.ones((1, *lon.shape)), [0.0])
        nemo(tmp_path / "v.nc", "vo", lon, lat, np.zeros((1, *lon.shape)), [0.0])
        field = open_field(tmp_path)
        assert np.isfinite(
            field(0, np.stack([np.linspace(-180, 540, 300), np.zeros(300)], 1))
        ).all()

    @pytest.mark.parametrize("corners", [True, False])
    @pytest.mark.parametrize("overlap", [0, 2])
    def test_staggered_round_the_earth(self, tmp_path, corners, overlap):
        # NEMO's points, without a seam, and with the first two columns once more at the end.
        j, i = np.linspace(-60, 60, 25), np.arange(72 + overlap)

        def at(j, i):
            lon, lat = np.meshgrid((5 * i + 180) % 360 - 180, j)
            return lon, lat + 2 * np.sin(np.radians(lon))

        ones = np.ones((1, len(j), len(i)))
        nemo(tmp_path / "u.nc", "uo", *at(j, i + 0.5), ones, [0.0])
        nemo(tmp_path / "v.nc", "vo", *at(j + 2.5, i), 0 * ones, [0.0])
        if corners:
            lon, lat = at(j + 2.5, i + 0.5)
            along = ("y", "x")
            variables = {"glamf": (along, lon, {}), "gphif": (along, lat, {})}
            write(tmp_path / "mesh.nc", variables, {"y": len(j), "x": len(i)})
        field = open_field(tmp_path)
        assert field.arakawa == "C" and len(field.x) == 73 + overlap // 2
        x = np.stack([np.linspace(-180, 540, 300), np.zeros(300)], 1)
        assert field(0, x)[:, 0] == pytest.approx(np.ones(300), abs=0.01)

    def test_velocities_along_a_curvilinear_grid_need_to_be_turned_first(self, tmp_path):
        at, j, i = bent(6, 7)
        lon, lat = at(j, i)
        shape = {"y": 6, "x": 7}
        for name in "uv":
            write(
                tmp_path / f"{name}.nc",
                {
                    "lon": (("y", "x"), lon, {}),
                    "lat": (("y", "x"), lat, {}),
                    name: (
                        ("y", "x"),
                        np.ones((6, 7)),
                        {"standard_name": f"sea_water_{'xy'['uv'.index(name)]}_velocity"},
                    ),
                },
                shape,
            )
        with pytest.raises(FormatError, match="along the rows of a curvilinear grid"):
            open_field(tmp_path)


class TestStraightAxes:
    @pytest.mark.parametrize("names", [("eastward_{}", "northward_{}"), ("{}_x", "{}_y"), ()])
    @pytest.mark.parametrize("falling", ["", "x", "y", "xy"])
    def test_staggered_velocities_are_towards_rising_coordinates(self, tmp_path, falling, names):
        x, y = 179 + 0.5 * np.arange(8), 40 + 0.5 * np.arange(7)
        axes = {"lonu": x, "lonv": x + 0.25, "latu": y + 0.25, "latv": y}
        variables, dimensions = {"time": (("time",), [0.0], {})}, {"time": 1}
        for name, axis in axes.items():
            units = "degrees_east" if "lon" in name else "degrees_north"
            axis = axis[:: -1 if "xy"["lon" not in name] in falling else 1]
            axis = (axis + 180) % 360 - 180
            variables[name] = ((name,), axis, {"units": units})
            dimensions[name] = len(axis)
        for name, speed in (("u", 0.3), ("v", 0.5)):
            standard = names["uv".index(name)].format("sea_water") + "_velocity" if names else ""
            variables[name] = (
                ("time", f"lat{name}", f"lon{name}"),
                np.full((1, 7, 8), speed),
                {"standard_name": standard} if names else {},
            )
        field = open_field(write(tmp_path / "uv.nc", variables, dimensions))
        assert field.arakawa == "C"
        assert field(0, [[180.6, 41.6]])[0] == pytest.approx([0.3, 0.5], rel=1e-4)

    def test_on_bent_rows_they_are_towards_rising_numbers(self, tmp_path):
        at, j, i = bent(8, 10)
        j = j[::-1]  # so that rows go south
        ones = np.ones((1, 8, 10))
        nemo(tmp_path / "u.nc", "uo", *at(j, i + 0.5), 0 * ones, [0.0])
        nemo(tmp_path / "v.nc", "vo", *at(j - 0.5, i), ones, [0.0])
        lon, lat = at([4.0], [5.0])
        assert open_field(tmp_path)(0, [[lon[0, 0], lat[0, 0]]])[0, 1] < -0.9


class TestCornersBesideOthers:
    def test_of_roms_with_velocities_at_its_rho_points_too(self, tmp_path):
        at, j, i = bent(8, 10)
        points = {
            "rho": at(j, i),
            "u": at(j, i[:-1] + 0.5),
            "v": at(j[:-1] + 0.5, i),
            "psi": at(j[:-1] + 0.5, i[:-1] + 0.5),
        }
        variables, dimensions = {}, {}
        for kind, (lon, lat) in points.items():
            along = (f"eta_{kind}", f"xi_{kind}")
            dimensions.update(zip(along, lon.shape, strict=True))
            variables[f"lon_{kind}"] = (along, lon, {"units": "degree_east"})
            variables[f"lat_{kind}"] = (along, lat, {"units": "degree_north"})
            if kind in ("u", "v"):
                variables[kind] = (along, np.ones(lon.shape), {"units": "meter second-1"})
        lon, lat = points["rho"]
        for name, values in (("u_eastward", lon + lat), ("v_northward", lon - lat)):
            standard = name[2:] + "_sea_water_velocity"
            along = ("eta_rho", "xi_rho")
            variables[name] = (along, values, {"standard_name": standard, "units": "m/s"})
        path = write(tmp_path / "roms.nc", variables, dimensions)
        x = np.array([[lon[3:5, 4:6].mean(), lat[3:5, 4:6].mean()]])
        for names in (("u_eastward", "v_northward"), None):
            field = open_field(path, names)
            assert field.arakawa == "A"
            assert field(0, x)[0] == pytest.approx([x.sum(), x[0, 0] - x[0, 1]], abs=1e-9)
        assert open_field(path, ("u", "v")).arakawa == "C"

    @pytest.mark.parametrize("standard", ["eastward northward", "x y"])
    def test_of_nemo_with_velocities_on_the_same_points(self, tmp_path, standard):
        # Eastward and northward they are no speeds through faces; along the rows they are.
        at, j, i = bent(8, 10)
        along, dimensions = ("y", "x"), {"y": 8, "x": 10}
        lon, lat = at(j, i)
        variables = {
            "nav_lon": (along, lon, {"units": "degrees_east"}),
            "nav_lat": (along, lat, {"units": "degrees_north"}),
        }
        variables["glamf"], variables["gphif"] = ((along, a, {}) for a in at(j + 0.5, i + 0.5))
        for name, kind, values in zip(
            ("uo", "vo"), standard.split(), (lon + lat, lon - lat), strict=True
        ):
            full = f"sea_water_{kind}_velocity" if len(kind) == 1 else f"{kind}_sea_water_velocity"
            variables[name] = (along, values, {"standard_name": full, "units": "m/s"})
        field = open_field(write(tmp_path / "uv.nc", variables, dimensions))
        if standard == "x y":
            assert field.arakawa == "C"
            return
        x = np.array([[lon[3:5, 4:6].mean(), lat[3:5, 4:6].mean()]])
        assert field.arakawa == "A"
        assert field(0, x)[0] == pytest.approx([x.sum(), x[0, 0] - x[0, 1]], abs=1e-9)


class TestXarray:
    def test_a_dataset_as_the_file_it_was_read_from(self, tmp_path):
        xarray = pytest.importorskip("xarray")
        lon, lat = np.meshgrid(np.linspace(0, 4, 9), np.linspace(45, 48, 7))
        u = np.random.default_rng(0).normal(size=(2, 7, 9))
        u[:, 2, 3] = -99
        times = {"units": "days since 2001-02-03"}
        with netcdf_file(
            nemo(tmp_path / "uv.nc", "uo", lon, lat, u, [0.0, 2.0], **times), "a"
        ) as f:
            f.variables["uo"]._FillValue = -99.0
            f.createVariable("vo", "d", ("time_counter", "y", "x"))[:] = 2 * u
        with xarray.open_dataset(tmp_path / "uv.nc", engine="scipy") as dataset:
            ours = open_field(dataset)
            theirs = open_field(tmp_path / "uv.nc")
            assert ours.origin == theirs.origin == np.datetime64("2001-02-03")
            x = np.random.default_rng(1).uniform([0, 45], [4, 48], (50, 2))
            for t in (0, DAY, 2 * DAY):
                assert np.array_equal(ours(t, x), theirs(t, x), equal_nan=True)
            parts = [dataset[[name, "nav_lon", "nav_lat"]] for name in ("uo", "vo")]
            assert np.array_equal(open_field(parts)(DAY, x), ours(DAY, x), equal_nan=True)
