/* FMI 2.0: the functions of the standard in terms of `instance.h`. */
#include "fmi2Functions.h"
#include "instance.h"

/* Inquiry, life cycle, values, saved states, derivatives (section 2.1). */

/* Named together in messages, for the size of the library. */
static const char OTHER_TYPES[] = "access to types other than Real";

static void log_message(const Instance *instance, Status status, const char *category, const char *message)
{
    const fmi2CallbackLogger logger = (fmi2CallbackLogger)instance->logger.callback;
    /* The message is complete and holds no format directive: many importers do not format it. */
    logger(instance->logger.environment, instance->name, (fmi2Status)status, category, message);
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    return (fmi2Status)instance_set_logging(c, loggingOn != fmi2False, nCategories, categories, __func__);
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation; /* there are no resources */
    (void)visible;
    if (!functions) return NULL;
    const Logger logger = {log_message, (AnyFunction)functions->logger, functions->componentEnvironment};
    const InterfaceType type = fmuType == fmi2CoSimulation ? CO_SIMULATION : MODEL_EXCHANGE;
    return instance_create(type, instanceName, fmuGUID, loggingOn != fmi2False, logger, __func__);
}

void fmi2FreeInstance(fmi2Component c)
{
    instance_free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    return (fmi2Status)instance_define_experiment(c, toleranceDefined ? &tolerance : NULL, startTime,
                                                  stopTimeDefined ? &stopTime : NULL, __func__);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    const Instance *instance = c;
    if (!allowed(instance, MODE_INSTANTIATED, __func__)) return fmi2Error;
    if (!instance->experiment_defined) {
        return (fmi2Status)refuse(instance, STATUS_ERROR, "%s: call fmi2SetupExperiment first.", __func__);
    }
    return (fmi2Status)instance_enter_initialization(c, __func__);
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    return (fmi2Status)instance_exit_initialization(c, __func__);
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    return (fmi2Status)instance_terminate(c, __func__);
}

fmi2Status fmi2Reset(fmi2Component c)
{
    return (fmi2Status)instance_reset(c, __func__);
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    return (fmi2Status)instance_get(c, vr, nvr, value, __func__);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    return (fmi2Status)instance_set(c, vr, nvr, value, __func__);
}

/* Both functions of a type that no variable has; the types differ in nothing but their names. */
#define NO_VARIABLES_OF_TYPE(Type)                                                                                    \
    fmi2Status fmi2Get##Type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2##Type value[])          \
    {                                                                                                                 \
        (void)vr;                                                                                                     \
        (void)value;                                                                                                  \
        return (fmi2Status)instance_get_other_type(c, nvr, OTHER_TYPES);                                              \
    }                                                                                                                 \
    fmi2Status fmi2Set##Type(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2##Type value[])    \
    {                                                                                                                 \
        (void)vr;                                                                                                     \
        (void)value;                                                                                                  \
        return (fmi2Status)instance_set_other_type(c, nvr, OTHER_TYPES);                                              \
    }

NO_VARIABLES_OF_TYPE(Integer)
NO_VARIABLES_OF_TYPE(Boolean)
NO_VARIABLES_OF_TYPE(String)

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return (fmi2Status)instance_get_state(c, FMUstate, __func__);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return (fmi2Status)instance_set_state(c, FMUstate, __func__);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return (fmi2Status)instance_free_state(c, FMUstate, __func__);
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    return (fmi2Status)instance_serialized_size(c, FMUstate, size, __func__);
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    return (fmi2Status)instance_serialize(c, FMUstate, serializedState, size, __func__);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    return (fmi2Status)instance_deserialize(c, serializedState, size, FMUstate, __func__);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown,
                                        const fmi2Real dvKnown[], fmi2Real dvUnknown[])
{
    return (fmi2Status)instance_derivative(c, false, vKnown_ref, nKnown, dvKnown, vUnknown_ref, nUnknown, dvUnknown,
                                           __func__);
}

/* Co-Simulation: communication steps and their status (section 4.2). */

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

/* Model Exchange (section 3.2). */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    return (fmi2Status)instance_enter_event_mode(c, __func__);
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *eventInfo)
{
    if (!allowed(c, MODE_EVENT, __func__) || !present(c, eventInfo, 1, __func__)) return fmi2Error;
    *eventInfo = (fmi2EventInfo){fmi2False, fmi2False, fmi2False, fmi2False, fmi2False, 0.0};
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    return (fmi2Status)instance_enter_continuous_time_mode(c, __func__);
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint; /* nothing is kept for going back */
    if (!allowed(c, MODE_CONTINUOUS_TIME, __func__) || !present(c, enterEventMode, 1, __func__) ||
        !present(c, terminateSimulation, 1, __func__)) {
        return fmi2Error;
    }
    *enterEventMode = fmi2False;
    *terminateSimulation = fmi2False;
    return fmi2OK;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    return (fmi2Status)instance_set_time(c, time, __func__);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    return (fmi2Status)instance_set_states(c, x, nx, __func__);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    return (fmi2Status)instance_get_derivatives(c, derivatives, nx, __func__);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    return (fmi2Status)instance_get_event_indicators(c, eventIndicators, ni, __func__);
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    return (fmi2Status)instance_get_states(c, x, nx, __func__);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    return (fmi2Status)instance_get_nominals(c, x_nominal, nx, __func__);
}
