//! Dense, zero-based indices as distinct types, so that a photo is never taken for a view.

use serde::{Deserialize, Serialize};

macro_rules! index_type {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(
            Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize,
        )]
        #[serde(transparent)]
        pub struct $name(pub usize);

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                self.0.fmt(f)
            }
        }
    };
}

index_type!(
    /// Index into [`crate::PhotoSet::photos`].
    PhotoIdx
);
index_type!(
    /// Index into [`crate::PosedViews::views`]: only photos that got a pose are views.
    ViewIdx
);
index_type!(
    /// Index into [`crate::PosedViews::points`].
    PointIdx
);
