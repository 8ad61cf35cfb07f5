"""`load_scene` on real files, and what it says to wrong input."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from stimuli import SCENES, load_scene
from stimuli.camera_path import camera_path
from stimuli.errors import InputError


@pytest.mark.parametrize(
    ("file", "triangles", "static_parts", "bodies", "moving_parts", "duration_s"),
    [
        ("bart_kitchen/bart_kitchen.glb", 110_561, 307, 5, 86, 20.0),
        ("bart_robots/bart_robots.glb", 71_708, 58, 156, 1_120, 50.0),
        ("sponza_dabrovic/sponza.glb", 66_445, 19, 0, 0, 0.0),
        ("white_room/white_room.glb", 414_841, 66, 0, 0, 0.0),
        ("staircase/staircase.glb", 262_663, 25, 0, 0, 0.0),
        ("cesium_milk_truck/CesiumMilkTruck.glb", 3_624, 3, 2, 2, 1.25),
        ("stanford_bunny/bun_zipper.ply", 69_451, 1, 0, 0, 0.0),
        ("utah_teapot/teapot.obj", 6_320, 1, 0, 0, 0.0),
        ("spot/spot.obj", 5_856, 1, 0, 0, 0.0),
        ("cornell_box/scene.gltf", 32, 8, 0, 0, 0.0),
    ],
)
def test_real_scenes_have_the_triangles_and_bodies_they_should(
    assets: Path, file: str, triangles: int, static_parts: int, bodies: int, moving_parts: int, duration_s: float
) -> None:
    scene = load_scene(assets / file)
    assert scene.triangle_count == triangles
    assert len(scene.static) == static_parts
    assert len(scene.movers) == bodies
    assert sum(len(mover.parts) for mover in scene.movers) == moving_parts
    assert scene.duration_s == duration_s
    assert scene.lights
    assert len(scene.sha256) == 64


def test_bart_kitchen_has_its_lights_ambient_background_and_phong(assets: Path) -> None:
    scene = load_scene(assets / "bart_kitchen/bart_kitchen.glb")
    assert [light.kind for light in scene.lights] == ["point"] * 6
    assert {light.falloff for light in scene.lights} == {"none"}
    assert scene.lights[0].position == (2.15, 2.0, 0.9)
    assert scene.lights[5].intensity == (0.4, 0.4, 0.4)
    assert (scene.ambient, scene.background, scene.default_exposure) == ((2.5, 2.5, 2.5), (0.5, 0.5, 1.0), 1.0)
    assert all(part.material.phong is not None for part in scene.static)


def test_bart_camera_flies_and_turns_and_the_toy_car_drives(assets: Path) -> None:
    scene = load_scene(assets / "bart_kitchen/bart_kitchen.glb")
    times = np.linspace(0.0, 20.0, 201)
    pose = scene.camera.pose(times)
    assert np.allclose(pose[0, :3, 3], (3.75, 2.3, 3.6), atol=1e-6)
    assert np.allclose(np.einsum("tji,tjk->tik", pose[:, :3, :3], pose[:, :3, :3]), np.eye(3), atol=1e-9)
    assert np.degrees(scene.camera.yfov_rad) == pytest.approx(40.0)
    walked = np.linalg.norm(np.diff(pose[:, :3, 3], axis=0), axis=1).sum()
    assert walked > 10.0
    assert np.array_equal(scene.camera.pose(np.array([25.0])), scene.camera.pose(np.array([20.0])))
    car = next(mover for mover in scene.movers if mover.name == "toycar").track.pose(times)
    assert np.linalg.norm(np.diff(car[:, :3, 3], axis=0), axis=1).sum() > 5.0
    # Between two of its 60 Hz keys the car is where linear interpolation puts it.
    middle, a, b = (scene.movers[0].track.pose(np.array([t / 60]))[0, :3, 3] for t in (300.5, 300.0, 301.0))
    assert np.allclose(middle, (a + b) / 2, atol=1e-9)


def test_the_toycar_path_stands_at_the_side_files_view_and_looks_at_the_car(assets: Path) -> None:
    scene = load_scene(assets / "bart_kitchen/bart_kitchen.glb")
    camera = camera_path(scene, "toycar")
    pose = camera.pose(np.array([0.0, 7.0]))
    assert np.array_equal(pose[0], pose[1])
    assert np.allclose(pose[0, :3, 3], (1.05369, 1.13876, 1.36377))
    car = next(mover for mover in scene.movers if mover.name == "toycar")
    places = car.track.pose(np.linspace(0.0, 20.0, 241))[:, :3, 3]
    seen = np.linalg.inv(pose[0]) @ np.append(places.mean(axis=0), 1.0)
    # The mean place of the car lies on the optical axis but for the height of its middle above its origin.
    assert seen[2] < -0.5
    assert np.degrees(np.arctan2(np.hypot(seen[0], seen[1]), -seen[2])) < 5.0


def test_sphere_and_area_lights_come_from_the_lights_file(assets: Path) -> None:
    (sphere,) = load_scene(assets / "sponza_dabrovic/sponza.glb").lights
    assert (sphere.kind, sphere.position, sphere.radius) == ("sphere", (0.0, 17.0, 0.0), 0.1)
    assert sphere.intensity == (16000.0, 16000.0, 16000.0)
    lights = load_scene(assets / "white_room/white_room.glb").lights
    assert [light.kind for light in lights] == ["area"] * 4
    for light in lights:
        across = np.cross(light.edge_u, light.edge_v)
        assert abs(np.dot(across, light.direction)) == pytest.approx(np.linalg.norm(across), rel=1e-4)


def test_robot_expressive_has_fourteen_animations_to_choose_from(assets: Path) -> None:
    file = assets / "robot_expressive/RobotExpressive.glb"
    dance, walk = load_scene(file), load_scene(file, "Walking")
    assert dance.duration_s != walk.duration_s
    assert dance.sha256 != walk.sha256
    assert dance.triangle_count == 3_237
    with pytest.raises(InputError, match=r"Dance \| Death \| Idle"):
        load_scene(file, "Fly")


def test_identity_covers_the_light_file_and_not_the_place(assets: Path, tmp_path: Path) -> None:
    source = assets / "sponza_dabrovic"
    for name in ("sponza.glb", "sponza_lights.json"):
        shutil.copy(source / name, tmp_path / name)
    here, there = load_scene(tmp_path / "sponza.glb"), load_scene(source / "sponza.glb")
    assert here.sha256 == there.sha256
    text = (tmp_path / "sponza_lights.json").read_text()
    (tmp_path / "sponza_lights.json").write_text(text.replace("17.0", "16.0"))
    assert load_scene(tmp_path / "sponza.glb").sha256 != there.sha256


def test_spot_takes_the_picture_beside_it_and_v_runs_down(assets: Path) -> None:
    scene = load_scene(assets / "spot/spot.obj")
    part = scene.static[0]
    source = part.material.pbr.baseColorTexture.source
    assert source.shape[2] == 4
    assert any("spot_texture.png" in note for note in scene.notes)
    # The hooves, lowest of all vertices, are grey; the body is pale.
    uv, y = part.primitive.texcoord_0, part.positions[:, 1]
    rows = np.clip((uv[:, 1] * source.shape[0]).astype(int), 0, source.shape[0] - 1)
    columns = np.clip((uv[:, 0] * source.shape[1]).astype(int), 0, source.shape[1] - 1)
    red = source[rows, columns, 0]
    assert np.median(red[y < y.min() + 0.02]) < 130
    assert np.median(red) > 200


def test_ply_with_nan_and_obj_with_words_are_refused(tmp_path: Path) -> None:
    ply = tmp_path / "bad.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
    ply.write_text(
        head + "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n"
    )
    with pytest.raises(InputError, match="bad vertices, the first is 1"):
        load_scene(ply)
    obj = tmp_path / "bad.obj"
    obj.write_text("v 0 0 0\nv 1 zero 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(InputError, match=r"bad\.obj:2: vertex: got 'v 1 zero 0', wanted three finite numbers"):
        load_scene(obj)
    empty = tmp_path / "empty.obj"
    empty.write_text("# nothing\n")
    with pytest.raises(InputError, match=r"empty\.obj"):
        load_scene(empty)
    cut = tmp_path / "cut.ply"
    cut.write_bytes(b"ply\nformat binary_little_endian 1.0\nelement vertex 99\nproperty float x\nend_header\n\0\0")
    with pytest.raises(InputError, match="broken mesh") as caught:
        load_scene(cut)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize(
    ("given", "wanted"),
    [
        ("nowhere.glb", "nowhere.glb: scene: got no such file or name, wanted"),
        ("tunnel_gem", r"tunnel_geom \| tunnel_maps"),
        ("", "a folder"),
    ],
)
def test_unknown_names_and_folders_are_refused_with_the_choices(
    given: str, wanted: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match=wanted):
        load_scene(given)


def test_other_file_types_and_animations_of_still_things_are_refused(tmp_path: Path) -> None:
    odd = tmp_path / "scene.fbx"
    odd.write_bytes(b"x")
    with pytest.raises(InputError, match=r"file type: got \.fbx, wanted \.glb"):
        load_scene(odd)
    with pytest.raises(InputError, match="a procedural scene has only its own"):
        load_scene("tunnel_geom", animation="walk")


@pytest.mark.parametrize("name", list(SCENES))
def test_procedural_scenes_are_the_same_on_every_call_and_well_formed(name: str) -> None:
    scene, again = SCENES[name](), load_scene(name)
    assert scene.sha256 == again.sha256
    assert scene.name == name
    assert scene.lights
    pairs = zip(
        [*scene.static, *(p for m in scene.movers for p in m.parts)],
        [*again.static, *(p for m in again.movers for p in m.parts)],
        strict=True,
    )
    for part, same in pairs:
        primitive = part.primitive
        assert primitive.positions.tobytes() == same.primitive.positions.tobytes()
        assert primitive.indices.tobytes() == same.primitive.indices.tobytes()
        assert np.isfinite(primitive.positions).all()
        assert primitive.indices.max() < len(primitive.positions)
        texture, other = part.material.pbr.baseColorTexture, same.material.pbr.baseColorTexture
        if texture is not None:
            assert texture.source.tobytes() == other.source.tobytes()
            assert primitive.texcoord_0 is not None
        corner = part.positions[primitive.indices]
        across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        area = np.linalg.norm(across, axis=1)
        assert (area > 0.0).all(), f"{part.name}: triangles without area"
        if primitive.normals is not None:
            assert np.allclose(np.linalg.norm(primitive.normals, axis=1), 1.0, atol=1e-5), part.name
            # Faces are wound to the side their vertex normals point to.
            agree = np.sum(across * primitive.normals[primitive.indices].sum(axis=1), axis=1) > 0.0
            assert agree.mean() > 0.98, f"{part.name}: {agree.mean():.3f} of the faces agree with their normals"
    pose = scene.camera.pose(np.linspace(0.0, max(scene.duration_s, 1.0), 50))
    assert np.allclose(np.einsum("tji,tjk->tik", pose[:, :3, :3], pose[:, :3, :3]), np.eye(3), atol=1e-9)


def test_the_tunnels_have_about_156k_triangles_and_one_point_light() -> None:
    geometry, maps = SCENES["tunnel_geom"](), SCENES["tunnel_maps"]()
    assert geometry.triangle_count == maps.triangle_count == 156_000
    assert [light.kind for light in geometry.lights] == ["point"]
    assert geometry.static[0].material.pbr.baseColorTexture is None
    assert all(part.material.pbr.baseColorTexture is not None for part in maps.static)
    assert {part.primitive.normals is None for part in maps.static} == {True, False}


def test_the_toy_cars_wheels_touch_the_floor_and_roll_without_slipping() -> None:
    scene = SCENES["toy_car"]()
    times = np.linspace(0.0, scene.duration_s, 2001)
    car = next(mover for mover in scene.movers if mover.name == "car").track.pose(times)
    assert np.allclose(car[0], car[-1], atol=1e-9)
    driven = np.linalg.norm(np.diff(car[:, :3, 3], axis=0), axis=1).sum()
    for wheel in [mover for mover in scene.movers if mover.name.startswith("wheel")]:
        low = min(
            float((part.positions @ part.matrix[:3, :3].T + part.matrix[:3, 3])[:, 1].min()) for part in wheel.parts
        )
        pose = wheel.track.pose(times)
        assert np.allclose(pose[:, 1, 3] + low, 0.0, atol=1e-6)
        # In the car's frame, front upper spokes move forward: the rim's top goes towards -z.
        local = np.linalg.inv(car[:2]) @ pose[:2]
        top = np.array([0.0, 0.045, 0.0])
        spin = local[1, :3, :3] @ local[0, :3, :3].T
        assert (spin @ top)[2] < 0.0
    rolled = scene.movers[3].track
    assert rolled.car.distance_m(np.array([scene.duration_s]))[0] == pytest.approx(driven, rel=1e-4)  # type: ignore[attr-defined]


def test_the_bar_has_fifteen_lights_mirrors_bottles_and_thin_bright_things() -> None:
    scene = SCENES["bar"]()
    assert len(scene.lights) >= 15
    assert {light.kind for light in scene.lights} >= {"point", "spot"}
    materials = [part.material for part in scene.static]
    assert any(m.pbr.metallicFactor == 1.0 and m.pbr.roughnessFactor == 0.0 for m in materials)
    assert any(m.transmission > 0.0 for m in materials)
    assert max(float(np.max(m.pbr.emissiveFactor)) for m in materials) > 5.0


def test_the_voxel_city_has_no_hidden_faces_and_its_camera_flies_through_air() -> None:
    from stimuli.procedural.shapes import generator
    from stimuli.procedural.voxel_city import SIDE, city

    scene = SCENES["voxel_city"]()
    voxels = city(generator("voxel_city"))
    faces = 0
    padded = np.pad(voxels != 0, 1)
    for axis in range(3):
        for sign in (1, -1):
            faces += int((padded & ~np.roll(padded, sign, axis))[1:-1, 1:-1, 1:-1].sum())
    ground = SIDE * SIDE
    assert scene.triangle_count == 2 * (faces - ground)
    eyes = scene.camera.pose(np.linspace(0.0, 8.0, 800))[:, :3, 3]
    cells = np.floor(np.add(eyes, (SIDE / 2, 0.0, SIDE / 2))).astype(int)
    inside = (cells >= 0).all(axis=1) & (cells < voxels.shape).all(axis=1)
    assert inside.any()
    assert (voxels[tuple(cells[inside].T)] == 0).all()


def test_the_mixed_reality_room_has_nine_objects_of_290k_triangles_and_a_light_on_a_circle(assets: Path) -> None:
    from stimuli.procedural.mixed_reality_room import PLACES, build

    scene = build()
    captured = [part for part in scene.static if part.material.captured]
    things = [part for part in scene.static if not part.material.captured]
    assert {part.name for part in things} == set(PLACES)
    assert len(captured) == 3
    assert sum(len(part.primitive.indices) for part in things) == pytest.approx(290_000, rel=0.01)
    (light,) = scene.lights
    assert light.track is not None
    places = light.track.pose(np.linspace(0.0, 12.0, 25))[:, :3, 3]
    assert np.allclose(np.linalg.norm((places - places.mean(axis=0))[:-1], axis=1), 1.0, atol=0.05)
    files = {
        "bunny": assets / "stanford_bunny/bun_zipper.ply",
        "teapot": assets / "utah_teapot/teapot.obj",
        "spot": assets / "spot/spot.obj",
    }
    given = build(files)
    assert given.sha256 != scene.sha256
    assert not given.notes
    for name, place in PLACES.items():
        corner = np.concatenate(
            [p.positions @ p.matrix[:3, :3].T + p.matrix[:3, 3] for p in given.static if p.name.startswith(name)]
        )
        assert corner[:, 1].min() == pytest.approx(place[1], abs=0.06), name
    with pytest.raises(InputError, match="bunny, teapot or spot"):
        build({"dragon": files["bunny"]})


def test_the_robot_walks_on_its_floor_and_every_scene_closes_its_loop() -> None:
    robot = SCENES["robot"]()
    assert len(robot.movers) == 16
    times = np.linspace(0.0, robot.duration_s, 161)
    lowest = np.full(161, np.inf)
    for mover in robot.movers:
        local = np.concatenate([p.positions @ p.matrix[:3, :3].T + p.matrix[:3, 3] for p in mover.parts])
        pose = mover.track.pose(times)
        lowest = np.minimum(lowest, (local @ pose[:, 1, :3].T + pose[:, 1, 3]).min(axis=0))
        assert np.allclose(pose[0], pose[-1], atol=1e-9), mover.name
    assert -0.02 < lowest.min() < 0.1
    for name in ("toy_car", "bar", "voxel_city", "living_room", "hairball", "robot", "mixed_reality_room"):
        scene = SCENES[name]()
        ends = scene.camera.pose(np.array([0.0, scene.duration_s]))
        assert np.allclose(ends[0], ends[1], atol=1e-9), name


def test_the_toy_car_hits_nothing_on_its_way() -> None:
    scene = SCENES["toy_car"]()
    inverse = np.linalg.inv(scene.movers[0].track.pose(np.linspace(0.0, 8.0, 200)))
    for part in scene.static:
        if part.name in ("blocks", "balls", "poles"):
            local = np.einsum("tab,nb->tna", inverse[:, :3, :3], part.positions) + inverse[:, None, :3, 3]
            gap = np.maximum(np.abs(local[..., 0]) - 0.1, np.abs(local[..., 2]) - 0.22)
            assert gap[local[..., 1] < 0.2].min() > 0.03, part.name
