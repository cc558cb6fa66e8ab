//! The run directory: fingerprints, atomic commits, a lock, and what is valid, stale or missing.
//!
//! ```text
//! RUN/run.json            what was asked (photos, masks, options) and the format version
//! RUN/.run.json           its copy
//! RUN/1_photos … 6_fusion artifacts of each stage; manifest.json says what they were made from
//! RUN/evaluation          where the errors of the results lie; goes with them
//! RUN/.work/ranks         for a moment: shows several processes that they see the same folder
//! RUN/.work/STAGE         a stage in progress; renamed to RUN/STAGE when it is complete
//! RUN/.lock               the process that works here
//! ```
//! A stage is committed by one rename after all its files, the manifest last, are on disk: whatever
//! stops the program, `RUN/STAGE` is either the old result or the new one. Manifests hold the content
//! hash of every file, and `run.json` and manifests one of themselves, so that damage is found before
//! anything is made from it.

mod checkpoint;
mod error;
mod evaluation;
mod files;
mod fingerprint;
mod lock;
mod manifest;
mod places;
mod run_dir;
mod run_file;
mod scratch;
mod sealed;
mod writer;

pub use checkpoint::StageCheckpoint;
pub use error::StoreError;
pub use evaluation::{deviation_file, drop_evaluation};
pub use files::{
    absolute, create_folder, hash_file, is_name, own_file, own_folder, write_atomically,
};
pub use fingerprint::{Ingredients, hash_bytes, hash_json};
pub use manifest::{FORMAT_VERSION, Item, Look, Manifest};
pub use run_dir::RunDir;
pub use scratch::FileScratch;
pub use sealed::{seal, unseal};
pub use writer::StageWriter;
