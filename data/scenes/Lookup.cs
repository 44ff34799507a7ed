// Answer from a table in C#: Lookup TABLE.wbt, then its loads, such as Fx Fy Fz Mx My Mz.
// It loads the shared library (wrenchbook.dll, libwrenchbook.so or libwrenchbook.dylib) of
// `wrenchbook export plate_thin plate.zip`, built with -DBUILD_SHARED_LIBS=ON.
using System;
using System.Globalization;
using System.Runtime.InteropServices;
using System.Text;

internal static unsafe class Native
{
    private const string Library = "wrenchbook";
    internal const int Max = 64, MaxReasons = 32; // WB_MAX, WB_MAX_REASONS

    // wb_options
    [StructLayout(LayoutKind.Sequential)]
    internal struct Options
    {
        public int method;
        public double* tolerance;
        public int without_rows;
    }

    // wb_reason
    [StructLayout(LayoutKind.Sequential)]
    internal struct Reason
    {
        public int code, group, axis, index;
        public double value, limit;
    }

    // wb_reply; C# has no fixed array of structs, so `reason` is its bytes: 32 a reason.
    [StructLayout(LayoutKind.Sequential)]
    internal struct Reply
    {
        public int coverage;
        public int within;
        public int method;
        public int exact;
        public int reasons;
        public int group;
        public int unknown;
        public int unused;
        public long row;
        public long index;
        public ulong missing;
        public fixed double inputs[Max];
        public fixed double outputs[Max];
        public fixed double error[Max];
        public fixed double interpolation[Max];
        public fixed double discretisation[Max];
        public fixed double linearity[Max];
        public fixed double measurement[Max];
        public fixed byte reason[MaxReasons * 32];
        public ulong solved;
    }

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern IntPtr wb_open(byte[] path, byte[] why, UIntPtr size);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern void wb_close(IntPtr table);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern int wb_inputs(IntPtr table);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern int wb_outputs(IntPtr table);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern UIntPtr wb_scratch(IntPtr table);

    [DllImport(Library, CallingConvention = CallingConvention.Cdecl)]
    internal static extern int wb_answer(
        IntPtr table, Options* options, double[] inputs, out Reply reply, IntPtr scratch);
}

internal static class Lookup
{
    private static unsafe int Main(string[] words)
    {
        byte[] why = new byte[256];
        byte[] path = Encoding.UTF8.GetBytes((words.Length > 0 ? words[0] : "") + "\0");
        IntPtr table = Native.wb_open(path, why, (UIntPtr)(uint)why.Length);
        if (table == IntPtr.Zero)
        {
            Console.Error.WriteLine(Encoding.UTF8.GetString(why).TrimEnd('\0'));
            return 1;
        }
        if (words.Length != 1 + Native.wb_inputs(table))
        {
            Console.Error.WriteLine($"the table has {Native.wb_inputs(table)} loads");
            return 1;
        }
        double[] loads = new double[Native.wb_inputs(table)];
        for (int k = 0; k < loads.Length; k++)
            loads[k] = double.Parse(words[1 + k], CultureInfo.InvariantCulture);
        IntPtr scratch = Marshal.AllocHGlobal((IntPtr)(long)(ulong)Native.wb_scratch(table));
        int code = Native.wb_answer(table, null, loads, out Native.Reply reply, scratch);
        if (code == 0)
        {
            Console.WriteLine(new[] { "covered", "thin", "outside" }[reply.coverage]);
            for (int k = 0; k < Native.wb_outputs(table); k++)
                Console.WriteLine(FormattableString.Invariant(
                    $"{reply.outputs[k]:R} +- {reply.error[k]:R}"));
        }
        Marshal.FreeHGlobal(scratch);
        Native.wb_close(table);
        return code;
    }
}
