from ._mpm_seeding import sample_box, sample_mesh, sample_sphere
