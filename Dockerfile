# g1stream with all extras, on Debian's Python. Cyclone DDS comes with the wheel on x86-64.
#
#   docker build -t g1stream .
#   docker run --rm -v "$PWD:/work" g1stream demo --out demo-out
#
# docs/install.md says which rights the loop can use, and how to reach a robot.
FROM debian:13-slim
RUN apt-get update \
    && apt-get install --yes --no-install-recommends python3 python3-venv libegl1 libopengl0 libgl1-mesa-dri libgomp1 \
    && rm -rf /var/lib/apt/lists/*
RUN python3 -m venv /opt/g1stream
COPY pyproject.toml constraints.txt README.md LICENSE /src/
COPY src /src/src
RUN /opt/g1stream/bin/pip install --no-cache-dir -c /src/constraints.txt \
    "/src[cluster,export,feet,fit,library,live,meshes,physics,policy,report,ros2,video]"
ENV PATH=/opt/g1stream/bin:$PATH
WORKDIR /work
ENTRYPOINT ["g1stream"]
