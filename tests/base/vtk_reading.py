"""Recordings as VTK reads them."""

import os

import pytest


def read_by_vtk(path):
    """(time, {part: data set}) of every step, in a pipeline as ParaView runs it; errors fail."""
    pytest.importorskip("vtkmodules.vtkIOHDF", reason="VTK is not installed")
    from vtkmodules.vtkCommonDataModel import vtkCompositeDataSet
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkFiltersCore import vtkPassThrough
    from vtkmodules.vtkIOHDF import vtkHDFReader

    errors = []
    reader = vtkHDFReader()
    reader.SetFileName(os.fspath(path))
    for source in (reader, reader.GetExecutive()):
        source.AddObserver("ErrorEvent", lambda *a: errors.append("error"))
        source.AddObserver("WarningEvent", lambda *a: errors.append("warning"))
    end = vtkPassThrough()
    end.SetInputConnection(reader.GetOutputPort())
    end.UpdateInformation()
    times = end.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    result = []
    for time in times or [None]:
        if time is None:
            end.Update()
        else:
            end.UpdateTimeStep(time)
        output = end.GetOutputDataObject(0)
        if output.IsA("vtkDataSet"):
            blocks = {None: output}
        else:
            blocks = {
                output.GetMetaData(i).Get(vtkCompositeDataSet.NAME()): output.GetBlock(i)
                for i in range(output.GetNumberOfBlocks())
            }
        copies = {}
        for name, block in blocks.items():
            copies[name] = block.NewInstance()
            copies[name].DeepCopy(block)
        result.append((time, copies))
        assert not errors
    return result
