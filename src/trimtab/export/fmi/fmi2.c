/* This text may be used, changed and passed on for any purpose, under any licence or none, without notice; it comes
 * without warranty. */

/* Co-simulation by FMI 2.0, based on fmu.h. Integer times (100 ns) and unsigned numbers are Reals here. */
#include "fmi2Functions.h"
#include "fmu.h"

#define STATUS(good) ((good) ? fmi2OK : fmi2Error)
#define REFERENCES fmi2Component c, const fmi2ValueReference vr[], size_t nvr

static void say(const fmu *f, const char *text)
{
    const fmi2CallbackFunctions *const calls = (const fmi2CallbackFunctions *)f->environment;
    if (calls && calls->logger)
        calls->logger(calls->componentEnvironment, f->name, fmi2Error, "logStatusError", "%s", text);
}

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories, const fmi2String categories[])
{
    (void)c, (void)loggingOn, (void)nCategories, (void)categories;
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)fmuResourceLocation, (void)visible, (void)loggingOn;
    if (fmuType != fmi2CoSimulation)
        return NULL;
    return fmu_create(instanceName, fmuGUID, (void *)functions, NULL, say);
}

void fmi2FreeInstance(fmi2Component c) { fmu_free((fmu *)c); }

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    (void)toleranceDefined, (void)tolerance, (void)stopTimeDefined, (void)stopTime;
    ((fmu *)c)->kept.start = startTime;
    return fmi2OK;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return STATUS(fmu_enter_initialization((fmu *)c, ((fmu *)c)->kept.start));
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return STATUS(fmu_exit_initialization((fmu *)c)); }

fmi2Status fmi2Terminate(fmi2Component c)
{
    ((fmu *)c)->kept.mode = FMU_ENDED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    fmu_reset((fmu *)c);
    return fmi2OK;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    return STATUS(fmu_step((fmu *)c, currentCommunicationPoint, communicationStepSize));
}

/* True if a variable has this type in FMI 2.0: FMU_F64 for Real, FMU_I32 for Integer, FMU_BOOL for Boolean. */
static bool is_seen_as(const fmu_variable *v, uint8_t type)
{
    return v->type == type || (type == FMU_F64 && v->type != FMU_I32 && v->type != FMU_BOOL);
}

static bool get_number(fmu *f, fmi2ValueReference reference, uint8_t type, double *value)
{
    const fmu_variable *v;
    const char *const at = fmu_look(f, reference, &v);
    if (!at)
        return false;
    *value = fmu_read(at, v->type);
    return is_seen_as(v, type) || fmu_fail(f, v->name, "the variable has another type");
}

static bool set_number(fmu *f, fmi2ValueReference reference, uint8_t type, double value)
{
    const fmu_variable *const v = fmu_find(f, reference);
    if (!v || !fmu_may_set(f, v))
        return false;
    return is_seen_as(v, type) ? fmu_set(f, v, 0, value) : fmu_fail(f, v->name, "the variable has another type");
}

#define ACCESS(Name, type)                                                                                             \
    fmi2Status fmi2Get##Name(REFERENCES, fmi2##Name value[])                                                           \
    {                                                                                                                  \
        for (size_t i = 0; i < nvr; i++) {                                                                             \
            double number = 0;                                                                                         \
            if (!get_number((fmu *)c, vr[i], type, &number))                                                           \
                return fmi2Error;                                                                                      \
            value[i] = (fmi2##Name)number;                                                                             \
        }                                                                                                              \
        return fmi2OK;                                                                                                 \
    }                                                                                                                  \
    fmi2Status fmi2Set##Name(REFERENCES, const fmi2##Name value[])                                                     \
    {                                                                                                                  \
        for (size_t i = 0; i < nvr; i++)                                                                               \
            if (!set_number((fmu *)c, vr[i], type, value[i]))                                                          \
                return fmi2Error;                                                                                      \
        return fmi2OK;                                                                                                 \
    }

ACCESS(Real, FMU_F64)
ACCESS(Integer, FMU_I32)
ACCESS(Boolean, FMU_BOOL)

fmi2Status fmi2GetString(REFERENCES, fmi2String value[])
{
    (void)c, (void)vr, (void)value;
    return STATUS(nvr == 0);
}

fmi2Status fmi2SetString(REFERENCES, const fmi2String value[])
{
    (void)c, (void)vr, (void)value;
    return STATUS(nvr == 0);
}

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    return STATUS((*FMUstate = fmu_save((fmu *)c, (fmu_snapshot *)*FMUstate)) != NULL);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    return STATUS(fmu_restore((fmu *)c, (const fmu_snapshot *)FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    (void)c;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    (void)c, (void)FMUstate;
    *size = sizeof(fmu_snapshot);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    (void)c;
    if (size < sizeof(fmu_snapshot))
        return fmi2Error;
    memcpy(serializedState, FMUstate, sizeof(fmu_snapshot));
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    return STATUS((*FMUstate = fmu_deserialize((fmu *)c, (const unsigned char *)serializedState, size)) != NULL);
}

/* Functions for features that this FMU does not have, according to its model description. */
#define ABSENT(name, ...)                                                                                              \
    fmi2Status name(__VA_ARGS__)                                                                                       \
    {                                                                                                                  \
        return fmi2Error;                                                                                              \
    }

#if defined(__GNUC__)
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif
ABSENT(fmi2GetDirectionalDerivative, fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
       const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[], fmi2Real dvUnknown[])
ABSENT(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer order[], const fmi2Real value[])
ABSENT(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer order[], fmi2Real value[])
ABSENT(fmi2CancelStep, fmi2Component c)
ABSENT(fmi2GetStatus, fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
ABSENT(fmi2GetRealStatus, fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
ABSENT(fmi2GetIntegerStatus, fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
ABSENT(fmi2GetBooleanStatus, fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
ABSENT(fmi2GetStringStatus, fmi2Component c, const fmi2StatusKind s, fmi2String *value)
