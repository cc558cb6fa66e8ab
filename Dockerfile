# The program with the shared libraries that it needs, for a machine without Rust; README.md says how to build and run it.

# Debian 12 with Rust.
FROM rust:1.95-bookworm AS build
WORKDIR /source
COPY .ci/setup .ci/setup
RUN .ci/setup
COPY . .
RUN cargo build --release --locked

FROM debian:12-slim
# flann, imgproc, core, and the C++ library come as what these depend on.
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libopencv-calib3d406 libopencv-features2d406 \
    && rm -rf /var/lib/apt/lists/*
COPY --from=build /source/target/release/rilievo /usr/local/bin/rilievo
# Without a folder of the host in its place, /data serves for `demo`.
RUN useradd --uid 1000 --create-home rilievo && install --directory --owner=rilievo --group=rilievo /data
# By number, which a cluster can tell from root.
USER 1000
WORKDIR /data
LABEL org.opencontainers.image.licenses="MIT OR Apache-2.0"
ENTRYPOINT ["rilievo"]
CMD ["--help"]
