"""Runs open-DARTS to a steady state of water, and prints the pressures as JSON.

    steady.py NAME.conn NAME.cells HIGH LOW     exported connections, two blocks with a fixed pressure
    steady.py NAME.msh HIGH LOW                 a mesh that open-DARTS discretises, two blocks with a fixed pressure
    steady.py NAME.conn NAME.cells NAME.wells   exported connections with wells

Numbers of blocks begin at 0."""

import contextlib
import importlib.util
import json
import os
import sys
import tempfile

# open-DARTS needs its own C++ library, which must be loaded before another one.
library = os.path.join(importlib.util.find_spec("darts").submodule_search_locations[0], "libstdc++.so.6")
if os.environ.get("LD_PRELOAD") != library:
    os.environ["LD_PRELOAD"] = library
    os.execv(sys.executable, [sys.executable, *sys.argv])
# Messages of open-DARTS go to standard error, so that standard output has nothing but JSON.
stdout = os.dup(1)
os.dup2(2, 1)

import numpy as np
from darts.engines import conn_mesh, index_vector, value_vector, well_control_iface
from darts.models.darts_model import DartsModel
from darts.physics.base.physics import PhysicsBase
from darts.physics.base.property_container import PropertyContainer
from darts.physics.properties.basic import ConstFunc
from darts.physics.properties.density import DensityBasic
from darts.physics.properties.flash import SinglePhase
from darts.reservoirs.reservoir_base import ReservoirBase
from darts.reservoirs.unstruct_reservoir import UnstructReservoir

has_wells = sys.argv[-1].endswith(".wells")
files = [os.path.abspath(a) for a in (sys.argv[1:] if has_wells else sys.argv[1:-2])]
ends = [] if has_wells else [int(a) for a in sys.argv[-2:]]


class Connections(ReservoirBase):
    """Blocks and connections from files."""

    def discretize(self, verbose=False):
        block_m, block_p, tran, tran_d = np.loadtxt(files[0]).T
        cells = np.loadtxt(files[1])
        mesh = conn_mesh()
        mesh.init(
            index_vector(block_m.astype(int).tolist()),
            index_vector(block_p.astype(int).tolist()),
            value_vector(tran.tolist()),
            value_vector(tran_d.tolist()),
        )
        for name, values in zip(("volume", "poro", "depth"), cells.T):
            np.array(getattr(mesh, name), copy=False)[:] = values
        return mesh

    def set_wells(self, verbose=False):
        """Adds the wells of a file."""
        with open(files[2]) as lines:
            rows = [line.split() for line in lines if not line.startswith("#")]
        for name, block, index, radius, control, value in rows:
            if self.get_well(name) is None:
                self.add_well(name, well_diameter=2 * float(radius))
                self.controls[name] = control, float(value)
            well = self.get_well(name)
            well.perforations = well.perforations + [(0, int(block), float(index), 0.0)]

    def set_boundary_volume(self, boundary_volumes):
        pass

    def add_perforation(self, *arguments, **options):
        pass

    def find_cell_index(self, coord):
        pass


class Model(DartsModel):
    def __init__(self):
        super().__init__()
        if files[0].endswith(".msh"):
            self.reservoir = UnstructReservoir(self.timer, files[0], 100, 100, 100, 0.2)
            import gmsh

            gmsh.initialize()
            gmsh.option.setNumber("General.Terminal", 0)
            gmsh.open(files[0])
            groups = gmsh.model.getPhysicalGroups()
            gmsh.finalize()
            self.reservoir.physical_tags["matrix"] = [t for d, t in groups if d == 3]
            self.reservoir.physical_tags["boundary"] = [t for d, t in groups if d == 2]
        else:
            self.reservoir = Connections(self.timer)
            self.reservoir.controls = {}
        water = PropertyContainer(
            phases_name=["wat"], components_name=["H2O"], Mw=[18.0], temperature=1.0
        )
        water.flash_ev = SinglePhase(1)
        water.density_ev = {"wat": DensityBasic(dens0=1000.0)}
        water.viscosity_ev = {"wat": ConstFunc(1.0)}
        water.rel_perm_ev = {"wat": ConstFunc(1.0)}
        self.physics = PhysicsBase(
            components=["H2O"],
            phases=["wat"],
            timer=self.timer,
            axes_step=[0.5],
            state_spec=PhysicsBase.StateSpecification.P,
        )
        self.physics.add_property_region(water)
        self.ts_control.dt_first = 1.0
        self.ts_control.dt_max = 1e6

    def set_wells(self, verbose=None):
        # Gravity has no effect if all blocks have the same depth.
        np.array(self.reservoir.mesh.depth, copy=False)[:] = 0.0
        if has_wells:
            self.reservoir.set_wells()

    def set_well_controls(self):
        for well in self.reservoir.wells:
            control, value = self.reservoir.controls[well.name]
            kind = well_control_iface.BHP if control == "pressure" else well_control_iface.VOLUMETRIC_RATE
            phase = None if control == "pressure" else "wat"
            self.physics.set_well_controls(well.control, kind, control == "inject", value, phase, [], 1.0)

    def set_initial_conditions(self):
        mesh = self.reservoir.mesh
        start = np.full(mesh.n_res_blocks, 200.0)
        # With a very large volume the pressure of a block is constant.
        for block, pressure in zip(ends, (201.0, 199.0)):
            start[block] = pressure
            np.array(mesh.volume, copy=False)[block] = 1e15
        self.physics.set_initial_conditions_from_array(mesh, {"pressure": start})


with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
    model = Model()
    model.init()
    model.set_output(output_folder=folder, save_initial=False)
    model.run(1e6, save_well_data=False, save_well_data_after_run=False, save_reservoir_data=False)
    blocks = model.reservoir.mesh.n_res_blocks
    pressure = np.array(model.physics.engine.X)[:blocks]
    volume = np.array(model.reservoir.mesh.volume)[:blocks]
    os.dup2(stdout, 1)
    print(json.dumps({"pressure": pressure.tolist(), "volume": volume.tolist()}), flush=True)
# End without the messages of open-DARTS at exit.
os._exit(0)
