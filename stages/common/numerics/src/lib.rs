//! Numerical building blocks that know nothing of photographs: masked-grid operators, multigrid,
//! conjugate gradients, least squares, rays against triangles, distance transforms, robust losses and a
//! derivative checker.

pub mod bvh;
pub mod conjugate_gradients;
pub mod corner_grid;
mod corner_operator;
pub mod corner_poisson;
pub mod derivatives;
pub mod distance;
pub mod least_squares;
pub mod lines;
mod multigrid;
pub mod plane;
pub mod plate_solver;
pub mod plate_system;
pub mod random;
pub mod robust;
pub mod solver_set;
pub mod sparse_cholesky;
pub mod thin_plate;
