//! Numerical building blocks that know nothing of photographs: masked-grid operators, multigrid,
//! conjugate gradients, least squares, robust losses and a derivative checker.

pub mod derivatives;
pub mod least_squares;
pub mod robust;
