/* FMI 2.0: inquiry, life cycle, values, saved states, derivatives (section 2.1). */
#include "fmi2Functions.h"
#include "instance.h"

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

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_get_other_type(c, nvr, OTHER_TYPES);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_get_other_type(c, nvr, OTHER_TYPES);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_get_other_type(c, nvr, OTHER_TYPES);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_set_other_type(c, nvr, OTHER_TYPES);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_set_other_type(c, nvr, OTHER_TYPES);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr;
    (void)value;
    return (fmi2Status)instance_set_other_type(c, nvr, OTHER_TYPES);
}

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
