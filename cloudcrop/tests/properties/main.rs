//! What must hold for every camera, cloud, mask and file.

mod clouds;
mod clusters;
mod lenses;
mod pcd;
mod planes;
mod ply;
mod registration;
mod strategies;
