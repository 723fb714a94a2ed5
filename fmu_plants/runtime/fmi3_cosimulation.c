/* FMI 3.0 for Co-Simulation (section 4.2). */
#include "fmi3Functions.h"
#include "instance.h"

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: Co-Simulation of this FMU has no event mode.", __func__);
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn,
                      fmi3Float64 *lastSuccessfulTime)
{
    const Instance *stepped = instance;
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!stepped) return fmi3Error;
    if (!present(stepped, eventHandlingNeeded, 1, __func__) || !present(stepped, terminateSimulation, 1, __func__) ||
        !present(stepped, earlyReturn, 1, __func__) || !present(stepped, lastSuccessfulTime, 1, __func__)) {
        return fmi3Error;
    }
    const Status status = instance_do_step(instance, currentCommunicationPoint, communicationStepSize, __func__);
    *eventHandlingNeeded = fmi3False;
    *terminateSimulation = fmi3False;
    *earlyReturn = fmi3False;
    *lastSuccessfulTime = simulation_time(stepped->simulation);
    return (fmi3Status)status;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    (void)valueReferences;
    (void)orders;
    (void)values;
    (void)nValues;
    if (!allowed(instance, MODES_ANY, __func__)) return fmi3Error;
    if (nValueReferences == 0) return fmi3OK;
    return (fmi3Status)refuse(instance, STATUS_ERROR, "%s: outputs have no derivatives.",
                              __func__);
}
