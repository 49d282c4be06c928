//! From scene and camera to an image: visibility first, then each visible point is lit once.

use cloudcrop::CameraIntrinsics;
use image::{ImageBuffer, Luma, Rgb, Rgb32FImage};
use nalgebra::{Isometry3, Matrix3, Point3, Vector3};

use super::mesh::Mesh;
use super::raster::{InverseDepth, NO_FACET, ZBuffer};
use super::scene::{Instance, Material, Scene};
use super::shadow::{ContactShade, ShadowMap};
use super::{DepthImage, Error, Result};

/// Which instance each pixel shows: the id that [`Scene::add`] returned, 0 where nothing is seen.
pub type InstanceImage = ImageBuffer<Luma<u16>, Vec<u16>>;

/// What a perfect camera sees.
#[derive(Clone, Debug, PartialEq)]
pub struct Rendering {
    /// Radiance, linear, anti-aliased; 0.18 is a middle grey before exposure.
    pub color: Rgb32FImage,
    /// Distance along the optical axis at the pixel centre, metres, 0 where nothing is seen.
    pub depth: DepthImage,
    /// Instance at the pixel centre.
    pub ids: InstanceImage,
    /// Cosine of the angle between viewing ray and surface normal at the pixel centre, 0 where nothing is seen.
    pub incidence: ImageBuffer<Luma<f32>, Vec<f32>>,
    /// The camera.
    pub camera: CameraIntrinsics,
}

/// Draws `scene` as a camera at `world_from_camera` (x right, y down, z forward) sees it.
///
/// Surfaces closer than 5 cm are cut off. Depth and ids are those of the pixel centres at integer coordinates; the
/// colour of a pixel across an edge is the mean of four samples.
///
/// # Errors
///
/// [`Error::Config`] if a focal length is not positive and finite, the principal point or the pose is not finite,
/// or the image has no pixel.
pub fn render(scene: &Scene, camera: &CameraIntrinsics, world_from_camera: &Isometry3<f64>) -> Result<Rendering> {
    check(camera, world_from_camera)?;
    let view = View::new(scene, camera, world_from_camera);
    let visible = view.visible(camera);
    let fine = view.visible(&doubled(camera));
    let lighting = Lighting::new(scene);
    let eye = world_from_camera.translation.vector.cast::<f32>().into();
    let painter = Painter { view: &view, lighting: &lighting, eye };
    let color = Rgb32FImage::from_fn(camera.width, camera.height, |u, v| Rgb(painter.pixel(&fine, u, v)));
    Ok(view.rendering(&visible, color))
}

/// As [`render`], but only which instance each pixel shows.
///
/// # Errors
///
/// As [`render`].
pub fn render_ids(
    scene: &Scene,
    camera: &CameraIntrinsics,
    world_from_camera: &Isometry3<f64>,
) -> Result<InstanceImage> {
    check(camera, world_from_camera)?;
    let view = View::new(scene, camera, world_from_camera);
    Ok(view.ids(&view.visible(camera)))
}

fn check(camera: &CameraIntrinsics, pose: &Isometry3<f64>) -> Result<()> {
    let focal = |f: f64| f.is_finite() && f > 0.0;
    let fit = focal(camera.fx)
        && focal(camera.fy)
        && camera.cx.is_finite()
        && camera.cy.is_finite()
        && (1..=16_384).contains(&camera.width)
        && (1..=16_384).contains(&camera.height);
    if !fit {
        let needed = "positive focal lengths, a finite principal point and 1 to 16384 pixels a side";
        return Err(Error::Config { field: "camera", found: format!("{camera:?}"), needed });
    }
    if !pose.to_matrix().iter().all(|x| x.is_finite()) {
        let found = format!("{pose:?}");
        return Err(Error::Config { field: "world_from_camera", found, needed: "finite numbers" });
    }
    Ok(())
}

/// The camera with twice the pixels a side: its pixels lie a quarter of a pixel around the centres of ours.
fn doubled(camera: &CameraIntrinsics) -> CameraIntrinsics {
    CameraIntrinsics {
        fx: 2.0 * camera.fx,
        fy: 2.0 * camera.fy,
        cx: 2.0 * camera.cx + 0.5,
        cy: 2.0 * camera.cy + 0.5,
        width: 2 * camera.width,
        height: 2 * camera.height,
    }
}

/// One triangle of one instance, ready to be lit.
struct Facet {
    instance: u16,
    part: u8,
    /// Whether normal and openness are the same at its vertices.
    is_flat: bool,
    vertices: [u32; 3],
    plane: InverseDepth,
}

/// An instance with its transforms in the form that is fast per pixel.
struct Placed<'a> {
    instance: &'a Instance,
    mesh_from_camera: (Matrix3<f32>, Vector3<f32>),
    world_from_mesh: (Matrix3<f32>, Vector3<f32>),
}

fn split_pose(pose: &Isometry3<f64>) -> (Matrix3<f32>, Vector3<f32>) {
    (pose.rotation.to_rotation_matrix().matrix().cast(), pose.translation.vector.cast())
}

/// The scene in the frame of a camera.
struct View<'a> {
    camera: &'a CameraIntrinsics,
    facets: Vec<Facet>,
    triangles: Vec<[Point3<f64>; 3]>,
    placed: Vec<Placed<'a>>,
}

impl<'a> View<'a> {
    fn new(scene: &'a Scene, camera: &'a CameraIntrinsics, world_from_camera: &Isometry3<f64>) -> Self {
        let mut view = Self { camera, facets: Vec::new(), triangles: Vec::new(), placed: Vec::new() };
        for (index, instance) in scene.instances().iter().enumerate() {
            let camera_from_mesh = world_from_camera.inverse() * instance.world_from_mesh;
            view.add_facets(index as u16, instance, &camera_from_mesh);
            view.placed.push(Placed {
                instance,
                mesh_from_camera: split_pose(&camera_from_mesh.inverse()),
                world_from_mesh: split_pose(&instance.world_from_mesh),
            });
        }
        view
    }

    fn add_facets(&mut self, index: u16, instance: &Instance, camera_from_mesh: &Isometry3<f64>) {
        let mesh = &instance.mesh;
        let corners: Vec<Point3<f64>> = mesh.positions().iter().map(|p| camera_from_mesh * p.cast::<f64>()).collect();
        for (&vertices, &part) in mesh.triangles().iter().zip(mesh.parts()) {
            let triangle = vertices.map(|i| corners[i as usize]);
            // A triangle seen edge-on covers nothing.
            if let Some(plane) = InverseDepth::of_plane(&triangle, self.camera) {
                let is_flat = is_flat(mesh, vertices);
                self.facets.push(Facet { instance: index, part, is_flat, vertices, plane });
                self.triangles.push(triangle);
            }
        }
    }

    fn visible(&self, camera: &CameraIntrinsics) -> ZBuffer {
        let mut buffer = ZBuffer::new(camera);
        for (facet, triangle) in self.triangles.iter().enumerate() {
            buffer.draw(facet as u32, triangle);
        }
        buffer
    }

    fn ids(&self, buffer: &ZBuffer) -> InstanceImage {
        let id = |facet: u32| self.facets.get(facet as usize).map_or(0, |f| f.instance + 1);
        InstanceImage::from_fn(self.camera.width, self.camera.height, |u, v| {
            Luma([id(buffer.facets[(v * self.camera.width + u) as usize])])
        })
    }

    fn rendering(&self, buffer: &ZBuffer, color: Rgb32FImage) -> Rendering {
        let camera = self.camera;
        let at = |u: u32, v: u32| (v * camera.width + u) as usize;
        let metres = |inverse: f32| if inverse > 0.0 { 1.0 / inverse } else { 0.0 };
        let depth =
            DepthImage::from_fn(camera.width, camera.height, |u, v| Luma([metres(buffer.inverse_depth[at(u, v)])]));
        let incidence = ImageBuffer::from_fn(camera.width, camera.height, |u, v| {
            Luma([self.incidence(buffer.facets[at(u, v)], f64::from(u), f64::from(v))])
        });
        Rendering { color, depth, ids: self.ids(buffer), incidence, camera: *camera }
    }

    /// Cosine between the ray of a pixel and the normal of the plane of a facet.
    fn incidence(&self, facet: u32, u: f64, v: f64) -> f32 {
        let Some(triangle) = self.triangles.get(facet as usize) else { return 0.0 };
        let normal = (triangle[1] - triangle[0]).cross(&(triangle[2] - triangle[0]));
        let ray = self.ray(u, v);
        (normal.dot(&ray).abs() / (normal.norm() * ray.norm())) as f32
    }

    /// The point at depth one on the ray of a pixel, camera frame.
    fn ray(&self, u: f64, v: f64) -> Vector3<f64> {
        let c = self.camera;
        Vector3::new((u - c.cx) / c.fx, (v - c.cy) / c.fy, 1.0)
    }
}

/// The lights with their shadows.
struct Lighting<'a> {
    scene: &'a Scene,
    shadows: Vec<ShadowMap>,
    contacts: Vec<ContactShade>,
}

impl<'a> Lighting<'a> {
    fn new(scene: &'a Scene) -> Self {
        let standing = scene.instances().iter().filter(|instance| instance.shades);
        Self {
            scene,
            shadows: scene.lights.iter().map(|light| ShadowMap::new(scene, light)).collect(),
            contacts: standing.map(ContactShade::of).collect(),
        }
    }

    /// Light that a matt white surface sends on, and the highlight towards an eye, per colour.
    fn at(&self, point: &Point3<f32>, normal: &Vector3<f32>, to_eye: Option<&Vector3<f32>>) -> ([f32; 3], [f32; 3]) {
        let (mut matt, mut shine) = ([0.0; 3], [0.0; 3]);
        for (light, shadow) in self.scene.lights.iter().zip(&self.shadows) {
            let towards = light.position.cast::<f32>() - point;
            let squared = towards.norm_squared().max(0.01);
            let direction = towards / squared.sqrt();
            let facing = normal.dot(&direction);
            if facing <= 0.0 {
                continue;
            }
            // Starting a little above the surface keeps it from shading itself at grazing light.
            let strength = shadow.lit_share(&(point + normal * 0.008)) / squared;
            let halfway = |to_eye: &Vector3<f32>| (direction + to_eye).normalize().dot(normal).max(0.0);
            let highlight = to_eye.map_or(0.0, |to_eye| halfway(to_eye).powi(24) * facing);
            for c in 0..3 {
                matt[c] += light.color[c] * strength * facing;
                shine[c] += light.color[c] * strength * highlight;
            }
        }
        (matt, shine)
    }

    fn ambient_share(&self, point: &Point3<f32>, is_floor: bool) -> f32 {
        if is_floor { self.contacts.iter().map(|c| c.open_share(point)).product() } else { 1.0 }
    }
}

/// Lights the points that a pixel sees.
struct Painter<'a> {
    view: &'a View<'a>,
    lighting: &'a Lighting<'a>,
    eye: Point3<f32>,
}

impl Painter<'_> {
    /// Colour of a pixel: each facet among its four samples is lit once and counts by its samples.
    fn pixel(&self, fine: &ZBuffer, u: u32, v: u32) -> [f32; 3] {
        let width = 2 * self.view.camera.width as usize;
        let first = 2 * v as usize * width + 2 * u as usize;
        let facets = [first, first + 1, first + width, first + width + 1].map(|i| fine.facets[i]);
        let (u, v) = (f64::from(u), f64::from(v));
        if facets.iter().all(|&facet| facet == facets[0]) {
            return self.facet_color(facets[0], u, v);
        }
        let mut sum = [0.0; 3];
        for (i, &facet) in facets.iter().enumerate() {
            if facets[..i].contains(&facet) {
                continue;
            }
            let samples = (0..4u8).filter(|&j| facets[usize::from(j)] == facet);
            let (mut count, mut du, mut dv) = (0.0, 0.0, 0.0);
            for j in samples {
                count += 1.0;
                du += f64::from(j % 2) * 0.5 - 0.25;
                dv += f64::from(j / 2) * 0.5 - 0.25;
            }
            let color = self.facet_color(facet, u + du / count, v + dv / count);
            (0..3).for_each(|c| sum[c] += color[c] * count as f32 / 4.0);
        }
        sum
    }

    fn facet_color(&self, facet: u32, u: f64, v: f64) -> [f32; 3] {
        if facet == NO_FACET {
            return [0.0; 3];
        }
        let facet = &self.view.facets[facet as usize];
        let placed = &self.view.placed[usize::from(facet.instance)];
        let depth = 1.0 / facet.plane.at(u, v).max(1e-3);
        let in_camera = (self.view.ray(u, v) * depth).cast::<f32>();
        let in_mesh = Point3::from(placed.mesh_from_camera.0 * in_camera + placed.mesh_from_camera.1);
        let (normal, openness) = surface_at(&placed.instance.mesh, facet, &in_mesh);
        let point = Point3::from(placed.world_from_mesh.0 * in_mesh.coords + placed.world_from_mesh.1);
        let to_eye = (self.eye - point).normalize();
        let facing = placed.world_from_mesh.0 * normal;
        let slant = facing.dot(&to_eye);
        // Surfaces have two sides: the one seen counts.
        let seen = if slant < 0.0 { -facing } else { facing };
        let footprint = depth as f32 / self.view.camera.fx as f32 / slant.abs().max(0.15).sqrt();
        let material = &placed.instance.materials[usize::from(facet.part)];
        let albedo = material.texture.albedo(&in_mesh, &normal, footprint);
        self.lit(material, albedo, openness, placed.instance.shades, &point, &seen, &to_eye)
    }

    #[expect(clippy::too_many_arguments, reason = "the terms of one lighting formula")]
    fn lit(
        &self,
        material: &Material,
        albedo: [f32; 3],
        openness: f32,
        standing: bool,
        point: &Point3<f32>,
        normal: &Vector3<f32>,
        to_eye: &Vector3<f32>,
    ) -> [f32; 3] {
        let (matt, shine) = self.lighting.at(point, normal, (material.gloss > 0.0).then_some(to_eye));
        let contact = self.lighting.ambient_share(point, !standing && normal.z > 0.9);
        // The sky side of a room is brighter than its floor side.
        let hemisphere = 0.8 + 0.2 * normal.z;
        let ambient = self.lighting.scene.ambient.map(|a| a * openness * contact * hemisphere);
        let light_in_hollow = openness.sqrt();
        [0, 1, 2].map(|c| albedo[c] * (ambient[c] + matt[c] * light_in_hollow) + material.gloss * shine[c])
    }
}

fn is_flat(mesh: &Mesh, [i, j, k]: [u32; 3]) -> bool {
    let same = |a: u32, b: u32| {
        let (a, b) = (a as usize, b as usize);
        mesh.normals()[a] == mesh.normals()[b] && mesh.openness()[a] == mesh.openness()[b]
    };
    same(i, j) && same(i, k)
}

/// Unit normal (frame of the mesh) and openness at a point of a triangle.
fn surface_at(mesh: &Mesh, facet: &Facet, point: &Point3<f32>) -> (Vector3<f32>, f32) {
    let [i, j, k] = facet.vertices.map(|v| v as usize);
    let (normals, openness) = (mesh.normals(), mesh.openness());
    if facet.is_flat {
        return (normals[i], openness[i]);
    }
    let [a, b, c] = [i, j, k].map(|v| mesh.positions()[v]);
    let (ab, ac, ap) = (b - a, c - a, point - a);
    let (bb, bc, cc) = (ab.norm_squared(), ab.dot(&ac), ac.norm_squared());
    let (pb, pc) = (ap.dot(&ab), ap.dot(&ac));
    let inverse = 1.0 / (bb * cc - bc * bc).max(1e-20);
    let wb = ((cc * pb - bc * pc) * inverse).clamp(0.0, 1.0);
    let wc = ((bb * pc - bc * pb) * inverse).clamp(0.0, 1.0 - wb);
    let wa = 1.0 - wb - wc;
    let normal = normals[i] * wa + normals[j] * wb + normals[k] * wc;
    (normal.try_normalize(1e-12).unwrap_or_else(Vector3::z), openness[i] * wa + openness[j] * wb + openness[k] * wc)
}
