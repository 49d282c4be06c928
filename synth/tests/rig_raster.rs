//! The renderer against ray casting, and its coverage against the geometry of meshes.
#![cfg(feature = "rig")]

use std::sync::Arc;

use cloudcrop::CameraIntrinsics;
use nalgebra::{Isometry3, Point3, Translation3, UnitQuaternion, Vector3};
use parry3d::math::{Pose, Vector};
use parry3d::query::{Ray, RayCast as _};
use parry3d::shape::TriMesh;
use proptest::prelude::*;
use synth::rig::{Instance, Material, Mesh, Scene, Shape, Texture, looking_at, render, render_ids};

fn camera() -> CameraIntrinsics {
    CameraIntrinsics { fx: 190.0, fy: 185.0, cx: 80.3, cy: 58.9, width: 160, height: 120 }
}

fn material() -> Material {
    Material { texture: Texture::plain([0.4; 3], 1), gloss: 0.0 }
}

fn add(scene: &mut Scene, mesh: Mesh, world_from_mesh: Isometry3<f64>) -> u16 {
    let materials = vec![material(); mesh.part_count()];
    scene
        .add(Instance { mesh: Arc::new(mesh), materials, world_from_mesh, shades: true })
        .expect("the mesh fits its materials")
}

fn pose() -> impl Strategy<Value = Isometry3<f64>> {
    (prop::array::uniform3(-0.6..0.6f64), prop::array::uniform3(-3.0..3.0f64)).prop_map(|(t, r)| {
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from(r));
        Isometry3::from_parts(Translation3::new(t[0], t[1], t[2] + 0.5), turn)
    })
}

/// The renderer cuts off what is nearer than this, metres; an eye may come to lie close to a shape or inside it.
const NEAR: f64 = 0.05;

/// Distance along the optical axis to the first surface of any instance beyond [`NEAR`], by ray casting.
struct Oracle {
    meshes: Vec<TriMesh>,
    eye: Point3<f64>,
    world_from_camera: Isometry3<f64>,
}

impl Oracle {
    fn new(scene: &Scene, world_from_camera: &Isometry3<f64>) -> Self {
        let meshes = scene.instances().iter().map(|instance| {
            let moved = |p: &Point3<f32>| {
                let q = (instance.world_from_mesh * p.cast::<f64>()).cast::<f32>();
                Vector::new(q.x, q.y, q.z)
            };
            let vertices = instance.mesh.positions().iter().map(moved).collect();
            TriMesh::new(vertices, instance.mesh.triangles().to_vec()).expect("a valid mesh")
        });
        let eye = world_from_camera.translation.vector.into();
        Self { meshes: meshes.collect(), eye, world_from_camera: *world_from_camera }
    }

    /// World direction of a pixel's ray, one metre along the optical axis.
    fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let c = camera();
        self.world_from_camera * Vector3::new((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0)
    }

    /// Depth and normal of what a pixel sees.
    fn hit(&self, u: f64, v: f64) -> Option<(f64, Vector3<f64>)> {
        let along = self.ray(u, v);
        let vector = |p: Vector3<f64>| Vector::new(p.x as f32, p.y as f32, p.z as f32);
        let ray = Ray::new(vector(self.eye.coords + along * NEAR), vector(along));
        let cast = |mesh: &TriMesh| mesh.cast_ray_and_get_normal(&Pose::IDENTITY, &ray, 50.0, false);
        let hits = self.meshes.iter().filter_map(cast);
        let first = hits.min_by(|a, b| a.time_of_impact.total_cmp(&b.time_of_impact))?;
        let normal = Vector3::new(first.normal.x, first.normal.y, first.normal.z).cast();
        Some((NEAR + f64::from(first.time_of_impact), normal))
    }

    fn depth(&self, u: f64, v: f64) -> f64 {
        self.hit(u, v).map_or(f64::INFINITY, |(depth, _)| depth)
    }

    /// Depth at pixel (u, v) of the plane that the ray `[du, dv]` pixels beside it meets.
    fn depth_continued(&self, u: f64, v: f64, [du, dv]: [f64; 2]) -> f64 {
        let Some((depth, normal)) = self.hit(u + du, v + dv) else { return f64::INFINITY };
        depth * normal.dot(&self.ray(u + du, v + dv)) / normal.dot(&self.ray(u, v))
    }
}

/// Places within 0.01 pixels, close enough to meet facets that are seen edge-on.
fn beside() -> impl Iterator<Item = [f64; 2]> {
    (-4..=4).flat_map(|i| (-4..=4).map(move |j| [f64::from(i) / 400.0, f64::from(j) / 400.0]))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Every pixel has the depth that a ray finds, within 0.2 mm; beside an edge, that of either surface, within 2 mm.
    #[test]
    fn depth_is_that_of_ray_casting(
        poses in prop::collection::vec(pose(), 3),
        eye in prop::array::uniform3(-1.0..1.0f64),
        out in 1.2..3.0f64,
    ) {
        let mut scene = Scene::new();
        for (shape, pose) in [Shape::LaundryBin, Shape::LBracket, Shape::Bottle].into_iter().zip(&poses) {
            add(&mut scene, shape.mesh(), *pose);
        }
        let floor = Mesh::new(
            vec![Point3::new(-9.0, -9.0, -1.0), Point3::new(9.0, -9.0, -1.0), Point3::new(0.0, 12.0, -1.0)],
            vec![Vector3::z(); 3],
            vec![[0, 1, 2]],
        ).unwrap();
        add(&mut scene, floor, Isometry3::identity());
        let eye = Point3::from(Vector3::from(eye).normalize() * out + Vector3::z() * 1.2);
        let world_from_camera = looking_at(eye, Point3::new(0.0, 0.0, 0.4), 0.2);
        let rendering = render(&scene, &camera(), &world_from_camera).unwrap();
        let oracle = Oracle::new(&scene, &world_from_camera);
        let (mut compared, mut beside_edges) = (0, 0);
        for (u, v, depth) in rendering.depth.enumerate_pixels() {
            if (u + 3 * v) % 7 != 0 {
                continue;
            }
            let (u, v, found) = (f64::from(u), f64::from(v), f64::from(depth.0[0]));
            let expected = oracle.depth(u, v);
            let agree = if found == 0.0 { expected.is_infinite() } else { (found - expected).abs() <= 2e-4 };
            compared += 1;
            if !agree {
                // Coverage is decided to 1/256 pixel, depth by the plane of the facet: only a pixel beside an edge may
                // see the other surface, however steeply that falls off.
                let met = beside().any(|offset| {
                    let z = oracle.depth_continued(u, v, offset);
                    if found == 0.0 { z.is_infinite() } else { (found - z).abs() <= 2e-3 }
                });
                prop_assert!(met, "pixel {u},{v}: {found} m, a ray finds {expected} m");
                beside_edges += 1;
            }
        }
        prop_assert!(compared > 2000);
        prop_assert!(beside_edges <= 30, "{beside_edges} of {compared}");
    }

    /// A plane cut into random triangles covers what the whole plane covers: no pixel is missed.
    ///
    /// With a bent second surface close behind, a gap would show as a pixel of the wrong instance.
    #[test]
    fn shared_edges_leave_no_gap(
        inner in prop::collection::vec((0.05..0.95f32, 0.05..0.95f32), 1..20),
        tilt in prop::array::uniform3(-0.6..0.6f64),
    ) {
        let mesh = fan_triangulation(&inner);
        let mut scene = Scene::new();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::from(tilt));
        let id = add(&mut scene, mesh, Isometry3::from_parts(Translation3::identity(), turn));
        let world_from_camera = looking_at(Point3::new(0.3, -0.2, 2.5), Point3::origin(), 0.1);
        let ids = render_ids(&scene, &camera(), &world_from_camera).unwrap();
        for v in 0..120 {
            let row: Vec<bool> = (0..160).map(|u| ids.get_pixel(u, v).0[0] == id).collect();
            let first = row.iter().position(|&x| x);
            let last = row.iter().rposition(|&x| x);
            // The outline is convex, so each row is one run.
            if let (Some(first), Some(last)) = (first, last) {
                prop_assert!(row[first..=last].iter().all(|&x| x), "row {v} has a gap");
            }
        }
    }
}

/// A square of 1.6 m in z = 0, cut by inserting points one after the other into the triangle that holds them.
fn fan_triangulation(inner: &[(f32, f32)]) -> Mesh {
    let at = |x: f32, y: f32| Point3::new(1.6 * x - 0.8, 1.6 * y - 0.8, 0.0);
    let mut points = vec![at(0.0, 0.0), at(1.0, 0.0), at(1.0, 1.0), at(0.0, 1.0)];
    let mut triangles = vec![[0u32, 1, 2], [0, 2, 3]];
    for &(x, y) in inner {
        let p = at(x, y);
        let side = |a: u32, b: u32| {
            let (a, b) = (points[a as usize], points[b as usize]);
            (b.x - a.x) * (p.y - a.y) - (b.y - a.y) * (p.x - a.x)
        };
        let holds = |t: &[u32; 3]| side(t[0], t[1]) > 1e-4 && side(t[1], t[2]) > 1e-4 && side(t[2], t[0]) > 1e-4;
        if let Some(i) = triangles.iter().position(holds) {
            let [a, b, c] = triangles.swap_remove(i);
            let new = points.len() as u32;
            points.push(p);
            triangles.extend([[a, b, new], [b, c, new], [c, a, new]]);
        }
    }
    let normals = vec![Vector3::z(); points.len()];
    Mesh::new(points, normals, triangles).expect("a valid mesh")
}
