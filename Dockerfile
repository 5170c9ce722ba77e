# docker build --tag safety-harness . ; docker run --rm --volume "$PWD:/work" safety-harness run my.yaml
FROM python:3.11-slim AS wheel
WORKDIR /source
COPY . .
RUN pip wheel --no-cache-dir --no-deps --wheel-dir /wheels .

FROM python:3.11-slim
COPY requirements.lock /tmp/
RUN --mount=type=bind,from=wheel,source=/wheels,target=/wheels \
    pip install --no-cache-dir --constraint /tmp/requirements.lock /wheels/*.whl \
    && useradd --create-home --uid 1000 harness \
    && install --directory --owner=harness /cache /work
# Machine code; a volume here keeps it from one container to the next.
ENV SAFETY_HARNESS_CACHE=/cache
VOLUME /cache
USER 1000
WORKDIR /work
ENTRYPOINT ["safety-harness"]
