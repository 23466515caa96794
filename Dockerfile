# Image of the program with TetGen and CGAL:
#   docker build -t atomesh .
#   docker run --rm -v "$PWD:/data" atomesh mesh image.npy --distance 8
# The program as a whole is under the AGPL, version 3 or later (see /usr/share/doc/atomesh).

FROM rust:1-bookworm AS build
RUN apt-get update && apt-get install -y --no-install-recommends \
    g++ libtet1.5-dev libcgal-dev libclang-dev && rm -rf /var/lib/apt/lists/*
WORKDIR /src
COPY . .
# --path . installs the program only, not the Python package, which is another member of the workspace.
RUN cargo install --locked --path . --root /opt/atomesh

FROM debian:bookworm-slim
RUN apt-get update && apt-get install -y --no-install-recommends \
    libtet1.5 libgmp10 && rm -rf /var/lib/apt/lists/*
COPY --from=build /opt/atomesh/bin/atomesh /usr/local/bin/atomesh
COPY LICENSE-MIT LICENSE-APACHE packaging/TetGen-AGPL-3.0 packaging/GPL-3.0 packaging/LGPL-3.0 \
    packaging/copyright /usr/share/doc/atomesh/
# Check that the program runs and finds its libraries.
RUN atomesh doctor
WORKDIR /data
ENTRYPOINT ["atomesh"]
