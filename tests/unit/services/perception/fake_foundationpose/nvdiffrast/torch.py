"""The one name of nvdiffrast that is used."""


class RasterizeCudaContext:
    pass
