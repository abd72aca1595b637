# The program in a small image. docs/install.md shows how to build and use it.

# The release of rust-toolchain.toml.
FROM rust:1.95.0-slim-trixie AS build
WORKDIR /src
COPY Cargo.toml Cargo.lock ./
COPY crates crates
# crates/loopboost/Cargo.toml names this file. It is not compiled.
COPY tests/main.rs tests/main.rs
RUN --mount=type=cache,target=/usr/local/cargo/registry \
    --mount=type=cache,target=/src/target \
    cargo build --release --locked --package loopboost \
    && strip -o /loopboost target/release/loopboost

FROM debian:trixie-slim
LABEL org.opencontainers.image.title="loopboost" \
      org.opencontainers.image.description="Loop closures, maps and models from the drive logs of robots" \
      org.opencontainers.image.licenses="MIT OR Apache-2.0"
RUN useradd --uid 1000 --create-home loopboost \
    && install --directory --owner=loopboost --group=loopboost /data
COPY --from=build /etc/ssl/certs/ca-certificates.crt /etc/ssl/certs/
COPY LICENSE-APACHE LICENSE-MIT /usr/share/doc/loopboost/
COPY --from=build /loopboost /usr/local/bin/
# A number, so that Kubernetes knows that it is not root.
USER 1000:1000
WORKDIR /data
ENTRYPOINT ["loopboost"]
