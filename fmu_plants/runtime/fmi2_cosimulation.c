/* FMI 2.0 for Co-Simulation: communication steps and their status (section 4.2). */
#include "fmi2Functions.h"
#include "instance.h"

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    return (fmi2Status)instance_do_step(c, currentCommunicationPoint, communicationStepSize, __func__);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    if (!allowed(c, MODES_ANY, __func__)) return fmi2Error;
    return (fmi2Status)refuse(c, STATUS_ERROR, "%s: steps are never pending.", __func__);
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr;
    (void)order;
    (void)value;
    if (!allowed(c, MODES_ANY, __func__)) return fmi2Error;
    if (nvr == 0) return fmi2OK;
    return (fmi2Status)refuse(c, STATUS_ERROR, "%s: inputs are not interpolated.", __func__);
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr;
    (void)order;
    (void)value;
    if (!allowed(c, MODES_ANY, __func__)) return fmi2Error;
    if (nvr == 0) return fmi2OK;
    return (fmi2Status)refuse(c, STATUS_ERROR, "%s: outputs have no derivatives.", __func__);
}

/* The answer to a status that only exists for steps that are pending. */
static fmi2Status never_pending(const Instance *instance)
{
    if (!instance) return fmi2Error;
    return (fmi2Status)refuse(instance, STATUS_DISCARD, "This status is not available, steps are never pending.");
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s;
    (void)value;
    return never_pending(c);
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    const Instance *instance = c;
    if (s != fmi2LastSuccessfulTime) return never_pending(instance);
    if (!allowed(instance, MODES_ANY, __func__)) return fmi2Error;
    if (!present(instance, value, 1, __func__)) return fmi2Error;
    *value = simulation_time(instance->simulation);
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s;
    (void)value;
    return never_pending(c);
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    const Instance *instance = c;
    if (s != fmi2Terminated) return never_pending(instance);
    if (!allowed(instance, MODES_ANY, __func__)) return fmi2Error;
    if (!present(instance, value, 1, __func__)) return fmi2Error;
    *value = fmi2False; /* the model never asks for the end */
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s;
    (void)value;
    return never_pending(c);
}
