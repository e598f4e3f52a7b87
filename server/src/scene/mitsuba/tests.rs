use super::super::{Color, Cutout, Distribution, Falloff, Finish, Light, Scalar, Scene, Surface, TextureKind};
use super::*;
use glam::{DVec3, Mat3, Vec2};
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::PathBuf;
use warplight_protocol::ImageSize;

/// A scene of these elements, beside the files of `folder`.
fn read_in(folder: &Path, elements: &str) -> Result<(Part, Option<Environment>), String> {
    let text = format!("<scene version='3.0.0'>\n{elements}\n</scene>");
    let tree = Tree::from_text(&folder.join("x.xml"), &text).map_err(|error| error.to_string())?;
    compose(&tree).map_err(|error| error.to_string())
}

fn part(elements: &str) -> Part {
    read_in(Path::new(""), elements).unwrap().0
}

fn error(elements: &str) -> String {
    let line = read_in(Path::new(""), elements).map(|_| ()).unwrap_err();
    assert!(line.starts_with("x.xml: ") && !line.contains('\n'), "{line}");
    line
}

/// The material of a rectangle with this BSDF, and the warnings.
fn material(bsdf: &str) -> (Material, Vec<String>) {
    let part = part(&format!("<shape type='rectangle'>{bsdf}</shape><emitter type='constant'/>"));
    let used = part.mesh.materials[0] as usize;
    (part.materials[used].clone(), part.warnings)
}

fn surface(bsdf: &str) -> Surface {
    let (material, warnings) = material(bsdf);
    assert_eq!(warnings, Vec::<String>::new());
    material.surface
}

#[test]
fn diffuse_surfaces_are_black_behind_unless_they_have_two_sides() {
    let (plain, _) = material("<bsdf type='diffuse'><rgb name='reflectance' value='0.1, 0.2 0.3'/></bsdf>");
    assert_eq!(plain.surface, Surface::Diffuse { albedo: Color::Constant(Vec3::new(0.1, 0.2, 0.3)) });
    assert!(plain.one_sided);
    let (both, _) = material("<bsdf type='twosided'><bsdf type='diffuse'/></bsdf>");
    assert_eq!((both.surface, both.one_sided), (Surface::Diffuse { albedo: Color::Constant(Vec3::splat(0.5)) }, false));
    let (default, _) = material("");
    assert!(default.one_sided && matches!(default.surface, Surface::Diffuse { .. }));
}

#[test]
fn colours_are_linear_or_hexadecimal_srgb() {
    let albedo = |value: &str| match surface(&format!("<bsdf type='diffuse'>{value}</bsdf>")) {
        Surface::Diffuse { albedo: Color::Constant(color) } => color,
        other => panic!("{other:?}"),
    };
    assert_eq!(albedo("<rgb name='reflectance' value='0.5'/>"), Vec3::splat(0.5));
    let hex = albedo("<rgb name='reflectance' value='#ff0080'/>");
    assert!((hex - Vec3::new(1.0, 0.0, 0.2159)).length() < 1e-3, "{hex}");
    assert_eq!(albedo("<spectrum name='reflectance' value='0.25'/>"), Vec3::splat(0.25));
    let sampled = albedo("<spectrum name='reflectance' value='300:0.4, 900:0.4'/>");
    assert!((sampled - Vec3::splat(0.4)).abs().max_element() < 2e-3);
}

#[test]
fn metals_have_their_indices() {
    assert_eq!(
        surface("<bsdf type='conductor'><spectrum name='eta' value='0.789'/><spectrum name='k' value='6.15'/></bsdf>"),
        Surface::Conductor {
            eta: Vec3::splat(0.789),
            k: Vec3::splat(6.15),
            filter: Color::Constant(Vec3::ONE),
            finish: Finish::SMOOTH
        }
    );
    assert_eq!(surface("<bsdf type='conductor'/>"), Surface::Mirror { filter: Vec3::ONE });
    let Surface::Conductor { eta, finish, .. } = surface(
        "<bsdf type='roughconductor'><string name='material' value='Au'/><float name='alpha_u' value='0.1'/>\
         <float name='alpha_v' value='0.3'/><string name='distribution' value='ggx'/></bsdf>",
    ) else {
        panic!()
    };
    assert!(eta.z > 1.4 && !finish.compensated && finish.distribution == Distribution::Ggx);
    assert_eq!(finish, Finish { compensated: false, ..Finish::along_axes(Distribution::Ggx, 0.1, 0.3) });
    let (_, warnings) = material("<bsdf type='conductor'><string name='material' value='Ir'/></bsdf>");
    assert!(warnings[0].contains("the indices of 'Ir' are not known"), "{warnings:?}");
}

#[test]
fn dielectrics_have_the_ratio_of_their_indices_by_number_or_name() {
    let Surface::Dielectric { ior, finish, filter, .. } = surface(
        "<bsdf type='roughdielectric'><string name='int_ior' value='water'/><float name='ext_ior' value='1'/>\
         <rgb name='specular_transmittance' value='0.5'/></bsdf>",
    ) else {
        panic!()
    };
    assert!((ior - 1.333).abs() < 1e-6 && filter == Color::Constant(Vec3::splat(0.5)));
    let rough = Finish::isotropic(Distribution::Beckmann, Scalar::Constant(0.1));
    assert_eq!(finish, Finish { compensated: false, ..rough });
    let Surface::Dielectric { ior, finish, .. } = surface("<bsdf type='dielectric'/>") else { panic!() };
    assert!((ior - 1.5046 / 1.000277).abs() < 1e-6 && finish.is_smooth());
    assert!(matches!(surface("<bsdf type='thindielectric'/>"), Surface::ThinDielectric { .. }));
    let (_, warnings) = material("<bsdf type='dielectric'><float name='specular_reflectance' value='0'/></bsdf>");
    assert!(warnings[0].contains("specular_reflectance of dielectrics is left out: 'x'") || warnings.len() == 1);
}

#[test]
fn layered_surfaces_are_approximated_and_say_so() {
    for (bsdf, what) in [
        ("<bsdf type='plastic'/>", "plastics become"),
        ("<bsdf type='roughplastic'><float name='alpha' value='0.2'/></bsdf>", "plastics become"),
        ("<bsdf type='principled'><float name='clearcoat' value='1'/></bsdf>", "principled BSDFs become"),
    ] {
        let (material, warnings) = material(bsdf);
        assert!(matches!(material.surface, Surface::Standard(_)) && material.one_sided);
        assert!(warnings.len() == 1 && warnings[0].contains(what), "{warnings:?}");
    }
    let Surface::Standard(standard) = material("<bsdf type='principled'/>").0.surface else { panic!() };
    assert!((standard.ior - 1.5).abs() < 1e-3 && standard.finish.alpha == Scalar::Constant(0.25));
}

#[test]
fn masks_are_holes_and_null_is_nothing() {
    let (masked, warnings) =
        material("<bsdf type='mask'><float name='opacity' value='0.3'/><bsdf type='diffuse'/></bsdf>");
    assert_eq!(masked.cutout, Some(Cutout { opacity: Scalar::Constant(0.3), threshold: None }));
    assert!(masked.one_sided && warnings.is_empty());
    assert_eq!(surface("<bsdf type='null'/>"), Surface::Null);
    let (bumped, warnings) =
        material("<bsdf type='bumpmap'><texture name='arbitrary' type='checkerboard'/><bsdf type='diffuse'/></bsdf>");
    assert!(matches!(bumped.surface, Surface::Diffuse { .. }) && warnings[0].contains("bump maps are left out"));
}

#[test]
fn references_may_come_first_and_by_another_name() {
    let part = part(
        "<shape type='rectangle'><ref id='b'/></shape><shape type='cube'><ref name='bsdf' id='a'/></shape>\
         <bsdf type='conductor' id='a'/><alias id='a' as='b'/><emitter type='constant'/>",
    );
    assert_eq!((part.materials.len(), part.materials[0].name.as_str()), (1, "a"));
    assert!(error("<shape type='rectangle'><ref id='z'/></shape>").contains("the id of an element, found 'z'"));
    assert!(
        error("<bsdf type='diffuse' id='a'/><bsdf type='diffuse' id='a'/>").contains("an id that line 2 has not taken")
    );
    let cycle = "<bsdf type='twosided' id='a'><ref id='a'/></bsdf><shape type='rectangle'><ref id='a'/></shape>";
    assert!(error(cycle).contains("at most 16 BSDFs in each other"));
}

fn view(sensor: &str) -> (Part, DVec3, DVec3, DVec3) {
    let part = part(&format!("<sensor type='perspective'>{sensor}</sensor><emitter type='constant'/>"));
    let turn = part.cameras[0].pose.orientation;
    (part, turn * DVec3::NEG_Z, turn * DVec3::X, turn * DVec3::Y)
}

#[test]
fn a_camera_looks_along_z_with_x_to_its_left() {
    let (part, ahead, right, up) = view(
        "<transform name='to_world'><lookat origin='-5,0,0' target='0,0,0' up='0,0,1'/></transform>\
         <film type='hdrfilm'><integer name='width' value='32'/><integer name='height' value='16'/><rfilter type='box'/></film>\
         <sampler type='independent'><integer name='sample_count' value='9'/></sampler><float name='fov' value='90'/>",
    );
    // Looking along +X with +Z up, +Y is on the left.
    assert!(
        (ahead - DVec3::X).length() < 1e-9 && (up - DVec3::Z).length() < 1e-9 && (right - DVec3::NEG_Y).length() < 1e-9
    );
    assert_eq!(part.cameras[0].pose.position, DVec3::new(-5.0, 0.0, 0.0));
    assert_eq!((part.defaults.size, part.defaults.spp), (Some(ImageSize::new(32, 16)), Some(9)));
    // 90 degrees are the horizontal field of view.
    assert!((f64::from(part.cameras[0].vertical_fov_rad) - 2.0 * 0.5_f64.atan()).abs() < 1e-6);
    assert_eq!(part.warnings, Vec::<String>::new());
    let (_, ahead, right, _) = view("");
    assert!((ahead - DVec3::Z).length() < 1e-9 && (right - DVec3::NEG_X).length() < 1e-9);
}

#[test]
fn fields_of_view_are_along_the_axis_that_is_named() {
    let film = "<film type='hdrfilm'><integer name='width' value='30'/><integer name='height' value='20'/></film>";
    let vertical = |keys: &str| f64::from(view(&format!("{film}{keys}")).0.cameras[0].vertical_fov_rad);
    let axis =
        |axis: &str| vertical(&format!("<float name='fov' value='60'/><string name='fov_axis' value='{axis}'/>"));
    let of_x = 2.0 * ((PI / 6.0).tan() / 1.5).atan();
    for (name, expected) in [("x", of_x), ("y", PI / 3.0), ("smaller", PI / 3.0), ("larger", of_x)] {
        assert!((axis(name) - expected).abs() < 1e-6, "{name}");
    }
    // The diagonal of a picture of 3 to 2 is that of the film: half of its height is 12 mm.
    assert!((vertical("<string name='focal_length' value='50mm'/>") - 2.0 * (12.0_f64 / 50.0).atan()).abs() < 1e-6);
    let half_diagonal = (axis("diagonal") / 2.0).tan() * 13.0_f64.sqrt() / 2.0;
    assert!((half_diagonal - (PI / 6.0).tan()).abs() < 1e-6);
}

#[test]
fn integrators_set_the_depth() {
    let depth = |integrator: &str| part(&format!("{integrator}<emitter type='constant'/>")).defaults.max_depth;
    assert_eq!(depth("<integrator type='direct'/>"), Some(2));
    let nested = "<integrator type='moment'><integrator type='aov'><string name='aovs' value='dd.y:depth'/>\
                  <integrator type='path'><integer name='max_depth' value='8'/></integrator></integrator></integrator>";
    assert_eq!(depth(nested), Some(8));
    assert!(depth("<integrator type='volpath'/>").unwrap() >= 1000);
    assert_eq!(depth(""), None);
}

#[test]
fn lights_stand_and_point_where_they_are_put() {
    let part = part(
        "<emitter type='point'><point name='position' x='1' y='2' z='3'/><rgb name='intensity' value='4'/></emitter>\
         <emitter type='spot'><float name='cutoff_angle' value='40'/><transform name='to_world'>\
         <lookat origin='0,5,0' target='0,0,0' up='0,0,1'/></transform></emitter>\
         <emitter type='directional'><vector name='direction' value='0,0,-2'/><rgb name='irradiance' value='1,2,3'/></emitter>",
    );
    assert_eq!(part.lights[0], Light::Point { position: Vec3::new(1.0, 2.0, 3.0), intensity: Vec3::splat(4.0) });
    let Light::Spot { position, axis, inner_rad, outer_rad, falloff, .. } = part.lights[1] else { panic!() };
    assert!((position - Vec3::Y * 5.0).length() < 1e-6 && (axis - Vec3::NEG_Y).length() < 1e-6);
    assert!((inner_rad.to_degrees() - 30.0).abs() < 1e-4 && (outer_rad.to_degrees() - 40.0).abs() < 1e-4);
    assert_eq!(falloff, Falloff::LinearInAngle);
    assert_eq!(part.lights[2], Light::Directional { direction: Vec3::NEG_Z, irradiance: Vec3::new(1.0, 2.0, 3.0) });
}

#[test]
fn area_lights_shine_on_one_side_of_their_shape() {
    let part = part(
        "<shape type='rectangle'><emitter type='area'><spectrum name='radiance' value='400:0, 500:8, 600:15.6, 700:18.4'/>\
         </emitter></shape>",
    );
    let material = &part.materials[0];
    let Color::Constant(radiance) = material.emission else { panic!() };
    // The light of the Cornell box: reddish.
    assert!(radiance.x > radiance.y && radiance.y > radiance.z && radiance.z > 0.0 && !material.emission_two_sided);
    assert!(error("<emitter type='area'/>").contains("an area light within a <shape>"));
}

fn png(folder: &Path, name: &str, texels: [[u8; 3]; 4]) {
    let image = image::RgbImage::from_raw(2, 2, texels.concat()).unwrap();
    image.save(folder.join(name)).unwrap();
}

const RED_GREEN_BLUE_WHITE: [[u8; 3]; 4] = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];

/// From the formula of Mitsuba's envmap: u = atan2(x, -z) / 2 pi, v = acos(y) / pi; the first column begins at -Z
/// and the image runs on over +X.
#[test]
fn an_envmap_begins_ahead_and_runs_to_the_right() {
    let folder = tempfile::tempdir().unwrap();
    let mut texels = [[0_u8; 3]; 8 * 4];
    texels[8] = [255, 0, 0]; // Row 1, column 0: just to the right of -Z, above the horizon.
    let image = image::RgbImage::from_raw(8, 4, texels.concat()).unwrap();
    image.save(folder.path().join("sky.png")).unwrap();
    let sky = |transform: &str| {
        let emitter = format!("<emitter type='envmap'><string name='filename' value='sky.png'/>{transform}</emitter>");
        read_in(folder.path(), &emitter).unwrap().1.unwrap()
    };
    let direction = |u: f32, v: f32| {
        let (phi, theta) = (u * std::f32::consts::TAU, v * std::f32::consts::PI);
        Vec3::new(phi.sin() * theta.sin(), theta.cos(), -phi.cos() * theta.sin())
    };
    // Rows are spread from pole to pole: the second of four is a third of the way down. It is looked up between
    // finer rows, an eighth of a row beside its peak at most.
    let lit = direction(0.5 / 8.0, 1.0 / 3.0);
    assert!((sky("").radiance(lit) - Vec3::X).length() < 0.125);
    assert!(sky("").radiance(direction(0.5 / 8.0, 2.0 / 3.0)).x < 0.125);
    assert_eq!(sky("").radiance(direction(2.5 / 8.0, 1.0 / 3.0)), Vec3::ZERO);
    // Z up: the image's +Y becomes the world's +Z.
    let turned =
        sky("<transform name='to_world'><rotate x='1' angle='90'/></transform><float name='scale' value='2'/>");
    let there = Mat3::from_rotation_x(std::f32::consts::FRAC_PI_2) * lit;
    assert!(there.z > 0.3 && (turned.radiance(there) - Vec3::X * 2.0).length() < 0.25);
    let mirrored = sky("<transform name='to_world'><scale x='-1'/></transform>");
    assert!((mirrored.radiance(lit * Vec3::new(-1.0, 1.0, 1.0)) - Vec3::X).length() < 0.125);
}

/// Mitsuba's bitmap has its first row where v is 0, and its obj turns v over: a picture on an OBJ stands upright, one
/// on a rectangle on its head.
#[test]
fn an_image_has_its_first_row_where_v_is_zero() {
    let folder = tempfile::tempdir().unwrap();
    png(folder.path(), "a.png", RED_GREEN_BLUE_WHITE);
    let obj = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n";
    std::fs::write(folder.path().join("a.obj"), obj).unwrap();
    let bsdf = "<bsdf type='diffuse'><texture name='reflectance' type='bitmap'><string name='filename' value='a.png'/></texture></bsdf>";
    let color_at = |shape: &str, corner: Vec3, towards: Vec2| {
        let part = read_in(folder.path(), &format!("{shape}{bsdf}</shape><emitter type='constant'/>")).unwrap().0;
        let vertex = part.mesh.positions.iter().position(|&position| (position - corner).length() < 1e-6).unwrap();
        part.textures[0].sample(part.mesh.uvs[vertex] + 0.25 * towards)
    };
    // A quarter of the picture inwards of the corner, the middle of the corner's texel.
    let rectangle = "<shape type='rectangle'>";
    assert_eq!(color_at(rectangle, Vec3::new(-1.0, -1.0, 0.0), Vec2::ONE), Vec3::X);
    assert_eq!(color_at(rectangle, Vec3::new(1.0, -1.0, 0.0), Vec2::new(-1.0, 1.0)), Vec3::Y);
    let file = "<shape type='obj'><string name='filename' value='a.obj'/>";
    assert_eq!(color_at(file, Vec3::Y, Vec2::ONE), Vec3::X);
    assert_eq!(color_at(file, Vec3::ZERO, Vec2::new(1.0, -1.0)), Vec3::Z);
    let unflipped = format!("{file}<boolean name='flip_tex_coords' value='false'/>");
    assert_eq!(color_at(&unflipped, Vec3::ZERO, Vec2::ONE), Vec3::X);
}

#[test]
fn checkers_have_two_squares_per_unit_and_take_a_transform() {
    let part = part(
        "<shape type='rectangle'><bsdf type='diffuse'><texture name='reflectance' type='checkerboard'>\
         <rgb name='color0' value='0.25'/><rgb name='color1' value='0.75'/>\
         <transform name='to_uv'><scale x='2' y='3'/></transform></texture></bsdf></shape><emitter type='constant'/>",
    );
    let at = |u, v| part.textures[0].sample(Vec2::new(u, v)).x;
    assert_eq!([at(0.1, 0.1), at(0.3, 0.1), at(0.3, 0.2), at(0.6, 0.1)], [0.25, 0.75, 0.25, 0.25]);
    assert!(matches!(part.textures[0].kind, TextureKind::Checker { .. }));
}

#[test]
fn normal_maps_are_read_as_they_are_and_their_green_runs_down() {
    let folder = tempfile::tempdir().unwrap();
    png(folder.path(), "n.png", [[128, 64, 255]; 4]);
    let bsdf = "<bsdf type='normalmap'><texture name='normalmap' type='bitmap'><string name='filename' value='n.png'/></texture>\
                <bsdf type='diffuse'/></bsdf>";
    let scene = format!("<shape type='cube'>{bsdf}</shape><emitter type='constant'/>");
    let part = read_in(folder.path(), &scene).unwrap().0;
    let map = part.materials[0].normal_map.unwrap();
    assert_eq!((map.texture, map.scale), (0, Vec2::new(1.0, -1.0)));
    let texel = part.textures[0].sample(Vec2::ZERO);
    assert!((texel - Vec3::new(128.0, 64.0, 255.0) / 255.0).length() < 1e-6, "{texel}");
}

#[test]
fn spheres_stay_exact_where_they_can() {
    let count = |keys: &str| {
        let part = part(&format!("<shape type='sphere'>{keys}</shape><emitter type='constant'/>"));
        (part.spheres.first().map(|sphere| (sphere.centre, sphere.radius)), part.mesh.triangles.len())
    };
    let moved = "<point name='center' x='1'/><float name='radius' value='0.5'/>\
                 <transform name='to_world'><scale value='2'/><rotate y='1' angle='180'/></transform>";
    let (sphere, triangles) = count(moved);
    let (centre, radius) = sphere.unwrap();
    assert!((centre - Vec3::new(-2.0, 0.0, 0.0)).length() < 1e-6 && radius == 1.0 && triangles == 0);
    assert!(count("<transform name='to_world'><scale x='2'/></transform>").1 > 1000);
    assert!(count("<boolean name='flip_normals' value='true'/>").1 > 1000);
    assert!(count("<bsdf type='diffuse'><texture type='checkerboard' name='reflectance'/></bsdf>").1 > 1000);
}

#[test]
fn flipped_and_mirrored_shapes_face_where_mitsuba_s_do() {
    let normal = |keys: &str| {
        let part = part(&format!("<shape type='rectangle'>{keys}</shape><emitter type='constant'/>"));
        let [a, b, c] = part.mesh.triangles[0].map(|index| part.mesh.positions[index as usize]);
        (b - a).cross(c - a).normalize()
    };
    assert_eq!(normal(""), Vec3::Z);
    assert_eq!(normal("<boolean name='flip_normals' value='true'/>"), Vec3::NEG_Z);
    assert_eq!(normal("<transform name='to_world'><scale x='-1'/></transform>"), Vec3::Z);
    assert_eq!(normal("<transform name='to_world'><scale z='-1'/></transform>"), Vec3::NEG_Z);
}

#[test]
fn meshes_without_normals_are_smooth_unless_told() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(
        folder.path().join("a.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n",
    )
    .unwrap();
    let read = |keys: &str| {
        let shape = format!(
            "<shape type='obj'><string name='filename' value='a.obj'/>{keys}</shape><emitter type='constant'/>"
        );
        read_in(folder.path(), &shape).unwrap().0.mesh
    };
    assert!(read("").normals[1].length() > 0.99);
    assert!(read("<boolean name='face_normals' value='true'/>").normals.iter().all(|&normal| normal == Vec3::ZERO));
}

#[test]
fn what_is_left_out_is_named_once() {
    let (part, _) = read_in(
        Path::new(""),
        "<medium type='homogeneous' id='m'><phase type='rayleigh'/></medium><shape type='cube' id='box'><bsdf type='null'/><ref name='interior' id='m'/></shape>\
         <shape type='serialized'/><shape type='cube' id='other'><ref name='interior' id='m'/><float name='colour' value='1'/></shape>\
         <emitter type='sunsky'/><sensor type='orthographic'/><sensor type='perspective'><film type='hdrfilm'>\
         <rfilter type='gaussian'/><integer name='crop_width' value='3'/></film></sensor>\
         <emitter type='constant'/><emitter type='constant'/>",
    )
    .unwrap();
    let lines = part.warnings.join("\n");
    for what in [
        "phase functions of type 'rayleigh' become isotropic",
        "shapes of type 'serialized' are left out",
        "the parameter 'colour' of a shape of type 'cube' is not used: 'other'",
        "emitters of type 'sunsky' are left out",
        "sensors of type 'orthographic' are left out",
        "pixels are filtered by a box",
        "pictures are not cropped",
        "of several surroundings the last counts",
    ] {
        assert_eq!(lines.matches(what).count(), 1, "{what}: {lines}");
    }
}

#[test]
fn what_mitsuba_has_not_either_is_an_error_with_its_place() {
    for (elements, part) in [
        ("<shape type='cone'/>", "x.xml: line 2, column 1: <shape>: expected a shape of type obj, ply,"),
        (
            "<shape type='rectangle'><bsdf type='difuse'/></shape>",
            "line 2, column 25: <bsdf>: expected a type such as diffuse",
        ),
        ("<emitter type='lamp'/>", "expected an emitter of type"),
        ("<sensor type='eye'/>", "expected a sensor of type"),
        ("<integrator type='magic'/>", "expected an integrator such as"),
        ("<shape type='obj'/>", "expected the parameter 'filename', found none"),
        (
            "<shape type='rectangle'><bsdf type='diffuse'><rgb name='reflectance' value='2'/></bsdf></shape>",
            "values from 0 to 1",
        ),
        (
            "<shape type='rectangle'><bsdf type='diffuse'><rgb name='reflectance' value='nan'/></bsdf></shape>",
            "a number, found 'nan'",
        ),
        (
            "<shape type='rectangle'><bsdf type='diffuse'><string name='reflectance' value='a'/></bsdf></shape>",
            "<texture> or a <ref>",
        ),
        (
            "<shape type='rectangle'><bsdf type='dielectric'><string name='int_ior' value='jelly'/></bsdf></shape>",
            "one of vacuum, helium",
        ),
        (
            "<shape type='rectangle'><bsdf type='roughconductor'><float name='alpha' value='7'/></bsdf></shape>",
            "alpha from 0 to 1",
        ),
        ("<shape type='sphere'><float name='radius' value='-1'/></shape>", "'radius': expected a number from"),
        ("<shape type='sphere'><point name='center' x='1e7'/></shape>", "a sphere within 1000000 m"),
        (
            "<shape type='rectangle'><transform name='to_world'><translate x='1e9'/></transform></shape>",
            "expected coordinates within",
        ),
        (
            "<sensor type='perspective'><float name='fov' value='0'/></sensor>",
            "'fov': expected a number from 0.1 to 179",
        ),
        (
            "<sensor type='perspective'><transform name='to_world'><translate x='1e9'/></transform></sensor>",
            "a camera within",
        ),
        ("<emitter type='constant'><spectrum name='radiance' value='500:1, 400:2'/></emitter>", "ascending wavelength"),
        ("<float name='x' value='1'/>", "expected <shape>, <emitter>"),
    ] {
        let folder = PathBuf::new();
        let line = read_in(&folder, elements).map(|_| ()).unwrap_err();
        assert!(line.contains(part) && !line.contains('\n'), "{line} / {part}");
    }
}

#[test]
fn a_scene_without_lights_is_lit_from_everywhere() {
    let (part, environment) = read_in(Path::new(""), "<shape type='cube'/>").unwrap();
    assert_eq!(environment, Some(Environment::Constant(Vec3::ONE)));
    assert!(part.warnings[0].contains("nothing emits light"));
}

#[test]
fn boundaries_of_media_are_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fog.xml");
    let text = "<scene version='3.0.0'><shape type='cube'><bsdf type='null'/></shape><shape type='sphere'/>\
                <emitter type='constant'/></scene>";
    std::fs::write(&path, text).unwrap();
    let scene = Scene::load(&path.to_string_lossy()).unwrap();
    assert_eq!((scene.mesh.triangles.len(), scene.spheres.len(), scene.name.as_str()), (0, 1, "fog"));
    assert!((scene.cameras[0].vertical_fov_rad - FRAC_PI_2 as f32).abs() < 1.0);
}

#[test]
fn media_are_read_once_and_named_by_the_materials_of_their_shapes() {
    let folder = tempfile::tempdir().unwrap();
    // Mitsuba's grid: head, 2x1x1 values of one channel, the box from 0 to 2.
    let mut bytes = b"VOL\x03".to_vec();
    bytes.extend([1_i32, 2, 1, 1, 1].iter().flat_map(|word| word.to_le_bytes()));
    bytes.extend([0.0_f32, 0.0, 0.0, 2.0, 2.0, 2.0, 0.25, 0.75].iter().flat_map(|word| word.to_le_bytes()));
    std::fs::write(folder.path().join("a.vol"), bytes).unwrap();
    let grid = |extra: &str| {
        format!(
            "<medium type='heterogeneous' id='g'><float name='scale' value='4'/><volume name='sigma_t' type='gridvolume'>\
             <string name='filename' value='a.vol'/><transform name='to_world'><translate x='1'/></transform>{extra}</volume>\
             <volume name='albedo' type='constvolume'><rgb name='value' value='0.5, 0.6, 0.7'/></volume></medium>\
             <shape type='cube'><bsdf type='null'/><ref name='interior' id='g'/></shape>"
        )
    };
    let (part, _) = read_in(
        folder.path(),
        &format!(
            "<medium type='homogeneous' id='m'><rgb name='sigma_t' value='1, 2, 3'/><float name='scale' value='2'/>\
             <float name='albedo' value='0.9'/><phase type='hg'><float name='g' value='-0.4'/></phase></medium>{}\
             <shape type='cube'><bsdf type='null'/><ref name='interior' id='m'/></shape>\
             <shape type='sphere'><bsdf type='dielectric'/><ref name='interior' id='g'/><ref name='exterior' id='m'/></shape>\
             <emitter type='constant'/>",
            grid("")
        ),
    )
    .unwrap();
    assert_eq!(part.warnings, Vec::<String>::new());
    let bounded: Vec<_> = part.materials.iter().map(|material| (material.interior, material.exterior)).collect();
    assert_eq!(bounded, [(Some(0), None), (Some(1), None), (Some(0), Some(1))]);
    let media = part.placed_media();
    assert_eq!((media.len(), media[1].phase.g), (2, -0.4));
    let fog = media[1].at(Vec3::splat(9.0));
    assert_eq!(fog.extinction, Vec3::new(2.0, 4.0, 6.0));
    assert!((fog.scattering - 0.9 * fog.extinction).abs().max_element() < 1e-6);
    // The unit cube stands at (1, 0, 0); a quarter of the way is the middle of the first cell.
    let smoke = media[0].at(Vec3::new(1.25, 0.5, 0.5));
    assert!((smoke.extinction - 1.0).abs().max_element() < 1e-6, "{smoke:?}");
    assert!((smoke.scattering - Vec3::new(0.5, 0.6, 0.7)).abs().max_element() < 1e-6);
    assert_eq!(media[0].at(Vec3::new(2.5, 0.5, 0.5)).extinction, Vec3::ZERO);
    let boxed = grid("<boolean name='use_grid_bbox' value='true'/>");
    let (part, _) = read_in(folder.path(), &format!("{boxed}<emitter type='constant'/>")).unwrap();
    assert!((part.placed_media()[0].at(Vec3::new(2.5, 1.0, 1.0)).extinction - 3.0).abs().max_element() < 1e-6);
}

#[test]
fn media_that_make_no_sense_are_errors_with_their_place() {
    for (medium, part) in [
        ("<medium type='fog' id='m'/>", "expected a medium of type homogeneous or heterogeneous, found 'fog'"),
        ("<medium type='homogeneous' id='m'><rgb name='albedo' value='2'/></medium>", "expected values from 0 to 1"),
        ("<medium type='homogeneous' id='m'><rgb name='sigma_t' value='-1'/></medium>", "expected values from 0 to"),
        (
            "<medium type='homogeneous' id='m'><phase type='hg'><float name='g' value='1.5'/></phase></medium>",
            "expected a number from -0.999",
        ),
        ("<medium type='homogeneous' id='m'><phase type='pgh'/></medium>", "a phase function of type isotropic or hg"),
        (
            "<medium type='heterogeneous' id='m'><volume name='sigma_t' type='gridvolume'/></medium>",
            "the parameter 'filename'",
        ),
        (
            "<medium type='heterogeneous' id='m'><volume name='sigma_t' type='noise'/></medium>",
            "gridvolume or constvolume",
        ),
    ] {
        let shape = "<shape type='cube'><bsdf type='null'/><ref name='interior' id='m'/></shape>";
        let line = read_in(Path::new(""), &format!("{medium}{shape}")).unwrap_err().to_string();
        assert!(line.contains(part) && line.contains("line 2") && !line.contains('\n'), "{line}");
    }
    let unnamed = "<medium type='homogeneous' id='m'/><shape type='cube'><ref id='m'/></shape>";
    let line = read_in(Path::new(""), unnamed).unwrap_err().to_string();
    assert!(line.contains("a medium of name interior or exterior"), "{line}");
}
